"""Stages of the grounding done elsewhere: masks, depth and poses from files or from another program's class."""
