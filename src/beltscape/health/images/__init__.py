"""Checks of the images of one frame set, before anything is matched.

`beltscape.health.image_statistics` reduces an image to a small grid of blocks; every check works on these grids, so
that all checks of a frame take one or two percent of the time of its matching. ``exposure``: saturation, darkness,
sunlight, flicker. ``sharpness``: defocus, condensation. ``projected_pattern``: projector, dust in the air, ageing of
the lamp. ``repeated``: frozen images. ``obstruction``: dirt on a window, from the light that each camera receives
from the points of a depth map.

``belt_images`` joins the checks that need the measured surface and the belt's motion too; they run every few frames.
``synchronisation``: delay of a camera, from the displacement of the moving material between cameras and frames.
``projector_position``: the projected pattern on the bare belt, against the learned one.
"""
