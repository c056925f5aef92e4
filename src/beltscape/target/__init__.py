"""Calibration boards and modules, their printed sheets, and the projected speckle pattern."""
