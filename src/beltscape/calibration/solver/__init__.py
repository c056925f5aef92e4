"""Numerical parts of the calibration: normal equations, Levenberg–Marquardt, SE(3), projection.

`bundle` adjusts the data of `bundle_data`: `levenberg_marquardt` minimises, `schur` eliminates the board poses from
the normal equations, `robust` weights the residuals. `projection` gives their Jacobians, `lens` and `lens_prior` the
parameters of lenses, `se3` those of poses. `perspective` is the pose from one view; `deterministic` keeps all of it
on one thread.
"""
