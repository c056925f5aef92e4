"""Plane sweep and semi-global aggregation."""
