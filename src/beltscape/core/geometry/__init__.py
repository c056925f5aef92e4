"""Rigid transforms named by their frames, the lens model, cameras and rigs, and their change of image size.

`pose` is a transform, `lens` a lens model by name with its `lens_domain` and the `tilt` of the sensor,
`camera` the intrinsics of one camera, and `rig` all cameras with their poses.
"""
