"""The volume between a loaded and the empty belt, with its standard deviation.

`volume` is the entrance: `load` is the height over the empty belt, with its integrals over a rectangle and the
capacity of the full belt; `uncertainty` holds the contributions to σ; `solid` makes a closed body for export.
`settings` are the engineer's.
"""
