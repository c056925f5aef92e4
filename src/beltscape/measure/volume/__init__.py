"""The volume between a loaded and the empty belt, with its standard deviation."""
