"""Reports on suite runs: one table, figure and page of several runs, and models compared on shared episodes."""
