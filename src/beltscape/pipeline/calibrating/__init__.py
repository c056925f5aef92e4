"""Calibration of captures, and checks of rigs on views they have not seen."""
