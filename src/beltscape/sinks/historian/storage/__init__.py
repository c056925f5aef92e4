"""Tables, files and connections: how records lie on disk."""
