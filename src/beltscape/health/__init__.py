"""Checks of the system by its own data.

Each compares two quantities that must agree, and returns a `Finding` with σ. `images` compares the images of
one frame set with each other, with those before, and with the reference values of each camera; `belt`
compares heights with the learned empty belt; `camera_poses` and `redundancy` judge the cameras of a frame.
The functions are pure: they take arrays, such as `image_statistics`, and return findings or estimates.
`reference` holds what a sound system looked like and `settings` the limits. Only the monitors, such as
`images.monitor` and `belt.monitor`, have a state: they carry the checks from frame to frame. Live, ``replay``,
``measure flow`` and ``reconstruct`` use the same ones.
"""
