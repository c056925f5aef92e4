"""A calibration module in one depth map: its pose, and the dimensions of its features.

`measure` is the entrance: `pose` finds the module, then `face` and `edges` measure flat faces, `sphere` and `cap`
spheres. `smoothing` and `matcher_scale` model what the matcher's windows do to a known shape, `correlation_area` how
its errors correlate; `result` holds the dimensions.
"""
