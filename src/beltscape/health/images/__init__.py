"""Checks of the images: of one frame set by itself, and with the measured surface and the belt's motion.

`beltscape.health.image_statistics` reduces an image to a small grid of blocks. The `block_checks` work on these grids
before anything is matched, so that all checks of a frame take one or two percent of the time of its matching;
`monitor` carries them over frames.

`belt_images` joins the `surface_checks`, which need the measured surface and the belt's motion too; they run every
few frames.
"""
