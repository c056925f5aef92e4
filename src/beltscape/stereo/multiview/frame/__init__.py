"""The prepared frame, the context that all stages share, and the surface on the matcher's grid.

`frame` (grey levels and projections, by `photometry`, `defocus`, `demosaicing`, `inverse_depth`) and `surface` are
what the stages pass on; `context` holds kernels, threads and `windows`. `parallel` runs independent jobs.
"""
