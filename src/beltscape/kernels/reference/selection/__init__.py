"""Candidate surfaces of a pixel: their photo-consistency, and propagation from its neighbours (reference)."""
