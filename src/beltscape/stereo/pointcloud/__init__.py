"""Depth maps as point clouds with normals and colour."""
