"""Plane sweep and semi-global aggregation: the reference."""
