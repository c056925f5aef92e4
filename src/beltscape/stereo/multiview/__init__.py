"""The multi-view matcher: one depth map in the core camera's view from all auxiliary cameras at once.

`reconstructor` is the entrance and gives the depth map in mm. A frame passes these modules in this order:
`frame` (by `photometry`: grey levels and cameras on the matcher's grid), `pyramid` (from the plane sweep of
`depth_range`, coarse to fine by `optimisation` of the `surface`), `textureless`, `candidates` (surfaces of
uncertain pixels, by `photoconsistency`) and `estimate`: networks predict σ and probability from `features`
and `refined_features`, and `correlated_noise` widens σ. `parallel` runs independent jobs.
"""
