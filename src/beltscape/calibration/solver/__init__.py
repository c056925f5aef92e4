"""Numerical parts of the calibration: bundle adjustment, Levenberg–Marquardt, lenses.

`bundle` adjusts its data with robust statistics; `levenberg_marquardt` minimises, eliminates the board poses
from the normal equations, and keeps all of it on one thread. `lens` has the parameters of lenses, the
projection of points with its Jacobians, and the pose from one view.
"""
