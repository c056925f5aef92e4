"""Synthetic scenes with exact truth, for the tests."""
