"""Checks of the images of one frame set, on a grid of blocks, before anything is matched.

`exposure`: saturation, darkness, sunlight, flicker. `lamp`: its ageing. `sharpness`: defocus, condensation.
`projected_pattern`: the projector, dust in the air. `repeated`: frozen images. `obstruction`: dirt on a window, from
the light that each camera receives from the points of a depth map.
"""
