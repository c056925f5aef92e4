"""The same chain, running: from cameras to records, for years."""
