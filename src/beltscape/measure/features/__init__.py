"""A calibration module in one depth map: its pose, and the dimensions of its features.

`measure` is the entrance: `pose` finds the module of `solids`, then `face` and `edges` (by `edge_likelihood`)
measure flat faces, `sphere` spheres. `smoothing` models what the matcher's windows do to a known shape;
`result` holds the dimensions.
"""
