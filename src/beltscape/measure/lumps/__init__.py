"""Lumps: segmentation of the top layer of a load on its depth map, with sizes, distribution and oversize alarm."""
