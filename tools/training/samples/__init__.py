"""Samples: features of matched or reconstructed training captures, with their truth."""
