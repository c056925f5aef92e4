"""Intrinsics of one camera by Zhang's method, and their sensitivity to the corners.

`zhang` calibrates a camera from its own views, `prior_fit` with prior knowledge of its lens. `lens_choice` compares
the lens models that `lens_fits` fits by `one_camera`, each from its `lens_starts`; `like_cameras` starts a camera
whose views do not determine its lens from the common lens of the others. `sensitivity` is the dependence of the
result on the corners.
"""
