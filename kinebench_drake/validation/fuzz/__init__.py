"""Damaged and hostile inputs by the thousand, held against every reader: each is read, or refused in one line."""
