"""Images of a world: ideal pinholes rendered by Mitsuba, then lens, shutter and sensor.

`render` is the entrance, also of a moving belt: `optics` covers a camera's image by ideal pinholes, for which
`lit_scene` (of `mitsuba_scene`) is rendered, and applies the lens; `sensor` makes pixel values.
"""
