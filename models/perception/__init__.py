"""The perception network and its weights."""
