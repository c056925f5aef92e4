"""Faults of a plant, each applied where it arises: to world, station, light, sensor, image, capture or encoder.

``settings`` lists them all. Those of light and image are functions on arrays, so that ``images`` can apply them to
the images of any capture without rendering it again.
"""
