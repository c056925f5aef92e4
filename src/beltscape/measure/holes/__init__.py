"""Occlusion holes: heights predicted for cells that no camera measured, from the cells around them.

`fill` is the entrance: `rims` are the first measured cells on both sides of each hole cell, `features` what
the networks predict its height and σ from.
"""
