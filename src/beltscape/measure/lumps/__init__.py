"""Lumps: segmentation of a load's top layer on its depth map, with sizes, distribution and oversize alarm.

`lumps` is the entrance for a frame, and measures each lump and the distribution of their sizes; `fused_belt` is
that for the fused belt of a flow. `features` makes heights comparable between rigs and gives the network of
outlines its input, `segment` cuts the raster. `settings` are the engineer's.
"""
