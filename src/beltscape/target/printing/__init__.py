"""Calibration boards as sheets to print in true size."""
