"""Videos in files, folders, manifests and datasets: one module per format, registered in `find`."""
