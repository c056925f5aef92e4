"""Dense stereo: frame sets to depth maps with their standard deviation, and point clouds.

`multiview` matches all auxiliary cameras at once; `pairwise` is the paper's method (Section 2.3); both take
their `settings` and the usable `cameras`. `pointcloud` turns depth into points; `markers` finds the projected
markers of the paper's Section 2.1. `consistency` checks the cameras of a frame against the rig.
"""
