"""Tables, files and connections: the storage of records on disk."""
