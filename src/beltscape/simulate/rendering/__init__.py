"""Images of a world: ideal pinholes rendered by Mitsuba, then lens, shutter and sensor."""
