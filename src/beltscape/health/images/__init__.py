"""Checks of the images: of one frame set by itself, and with the measured surface and the belt's motion.

`beltscape.health.image_statistics` reduces an image to a small grid of blocks. Checks on these grids come
before anything is matched, so that all checks of a frame take one or two percent of the time of its matching.
`exposure`: saturation, darkness, sunlight, flicker. `lamp`: its ageing. `sharpness`: defocus, condensation.
`projected_pattern`: the projector, dust in the air. `repeated`: frozen images. `obstruction`: dirt on a
window, from the light that each camera receives from the points of a depth map. `monitor` carries them over
frames.

Other checks need the measured surface and the belt's motion too, and run every few frames; `belt_images`
joins them. `surface_samples` are the points whose images are compared. `synchronisation`: delay of a camera,
from the displacement of the moving material between cameras and frames, which `synchronisation_monitor`
carries over frames. `projector_position`: the projected pattern on the bare belt, against the learned one.
"""
