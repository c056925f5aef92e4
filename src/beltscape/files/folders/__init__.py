"""Output on disk: atomic files, manifests, and folders that a command owns."""
