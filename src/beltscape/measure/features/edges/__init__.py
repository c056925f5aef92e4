"""Edges of a face, located in the image and at the rim of the depth map, in a band around each edge."""
