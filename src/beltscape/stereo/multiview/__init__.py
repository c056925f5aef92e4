"""The multi-view matcher: one depth map in the core camera's view from all auxiliary cameras at once.

A frame passes the sub-packages in this order: `frame` (grey levels and cameras on the matcher's grid),
`initialisation` (plane sweep), `optimisation` (propagation and least squares, coarse to fine in
`pyramid`), `selection` (candidate surfaces of uncertain pixels) and `confidence` (σ, probability, refinement).
`state` carries the result from stage to stage. `reconstructor` is the entrance and gives the depth map in mm.
"""
