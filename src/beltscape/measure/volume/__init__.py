"""The volume between a loaded and the empty belt, with its standard deviation.

`volume` is the entrance: `load` is the height over the empty belt, `box` integrates it over a rectangle,
`uncertainty` combines σ, `capacity` compares with the full belt, `solid` makes a closed body for export.
"""
