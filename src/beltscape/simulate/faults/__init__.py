"""Faults of a plant, each applied where it arises: world, station, light, sensor, image, capture or encoder.

`settings` lists them all, by the classes of `base`: of the `belt`, the `cameras`, `lighting`, `obstruction`
and `delivery`. Those of light and image are functions on arrays, so that `settings` can apply them to the
images of any capture without rendering it again.
"""
