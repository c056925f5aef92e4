"""Checks of images on the measured surface, with the belt's motion; they run every few frames.

`surface_samples` are the points whose images are compared, `motion_correlation` compares them. `synchronisation`:
delay of a camera, from the displacement of the moving material between cameras and frames. `projector_position`: the
projected pattern on the bare belt, against the learned one. A monitor carries each over frames.
"""
