"""Reconstruction and rectification of captures, with the check of the cameras."""
