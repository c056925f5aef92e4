"""Day archives, zip and tar: lists of their members with byte ranges, and reading of one member by its range."""
