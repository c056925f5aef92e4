"""Reconstruction and rectification of captures, with a consistency check of the cameras."""
