"""Numerical parts of the calibration: normal equations, Levenberg–Marquardt, SE(3), projection."""
