"""Captures on disk as they are recorded: one being written, a ring of the last minutes, those to keep."""
