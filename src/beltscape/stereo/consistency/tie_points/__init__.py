"""Tie points: points of the core image and their matches in the auxiliary images."""
