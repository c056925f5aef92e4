"""Checks of the system by its own data: each compares two quantities that must agree, and returns a `Finding` with σ.

``images/`` compares the images of one frame set with each other, with those before, and with the reference values of
each camera. The functions are pure: they take arrays and return findings or estimates. `reference` holds what a sound
system looked like and `settings` the limits. Only the monitors (`images/monitor`, `images/belt_images`) have a state:
they carry the checks from frame to frame. Live, `replay`, `measure flow` and `reconstruct` use the same ones.

Import from the modules: ``from beltscape.health.images.monitor import ImageMonitor``.
"""
