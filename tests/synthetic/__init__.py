"""Exact little worlds to test against."""
