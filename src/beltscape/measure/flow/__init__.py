"""A moving belt: what passes, strip by strip."""
