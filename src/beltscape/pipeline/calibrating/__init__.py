"""Calibration of captures, and checks of rigs on views that they were not calibrated with."""
