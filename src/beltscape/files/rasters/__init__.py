"""Rasters: images, depth maps and height maps."""
