"""The self-contained html report."""
