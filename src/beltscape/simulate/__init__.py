"""A rendered plant with exact truth."""
