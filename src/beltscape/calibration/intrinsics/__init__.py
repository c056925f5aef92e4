"""Intrinsics of one camera by Zhang's method, and their sensitivity to the corners.

`zhang` calibrates a camera from its own views, also with prior knowledge of its lens. `lens_choice` compares
the lens models of `lens_fits`; `like_cameras` starts a camera whose views do not determine its lens from the
common lens of the others. `sensitivity` is the dependence of the result on the corners.
"""
