"""Images of a world: ideal pinholes rendered by Mitsuba, then lens, shutter and sensor.

`render` is the entrance, `motion_blur` that of a moving belt: `pinhole` covers a camera's image by ideal pinholes,
for which `lit_scene` (of `mitsuba_light` and `mitsuba_scene`) is rendered by the `engine` and `view`; `optics`
applies the lens, `sensor` makes pixel values.
"""
