"""Lumps: segmentation of the top layer of a load on its depth map, with sizes, distribution and oversize alarm.

`lumps` is the entrance: `raster` makes heights comparable between rigs, `features` and the network of `outlines` give
the probability of an outline, `segment` cuts the raster by `basins`, `merging` and `rims`, `shape` measures each lump
and `distribution` their sizes.
"""
