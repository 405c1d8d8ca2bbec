"""Task families: assets, tasks and scripted expert side by side, one folder each."""
