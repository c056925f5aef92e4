"""Edges of a face: the image and the rim of the depth map in a band about each edge."""
