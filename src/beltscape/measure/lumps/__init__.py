"""Lumps: segmentation of a load's top layer on its depth map, with sizes, distribution and oversize alarm.

`lumps` is the entrance and measures each lump and the distribution of their sizes: `features` makes heights
comparable between rigs and gives the network of outlines its input, `segment` cuts the raster. `settings` are
the engineer's.
"""
