"""Video samples from files, folders, manifests and dataset formats: one module a format, their registry in `find`."""
