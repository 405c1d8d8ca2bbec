"""Reports: the page of an output folder, pages of several suite runs, 3D replays."""
