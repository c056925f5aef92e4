"""Recorded captures on disk: the one being written, a ring of the last minutes, and kept ones."""
