"""Tilt of the sensors of calibrated cameras (Scheimpflug), with its standard deviation."""

from __future__ import annotations

import numpy as np

from beltscape.core.geometry.rig import Rig


def describe_tilts(rig: Rig) -> list[str]:
    """Return a line with both angles for every camera of the tilted model."""
    parameters = list(rig.covariance.get("parameters", ()))
    matrix = np.asarray(rig.covariance.get("matrix", ()), np.float64)
    lines: list[str] = []
    for name, camera in rig.cameras.items():
        if not camera.lens.has_tilt:
            continue
        angles = np.degrees(camera.distortion[-2:])
        places = [parameters.index(f"{name}.{each}") for each in ("tau_x_rad", "tau_y_rad")]
        sigmas = np.degrees(np.sqrt(np.diag(matrix)[places]))
        x, y = (f"{angle:+.3f}° ± {sigma:.3f}°" for angle, sigma in zip(angles, sigmas, strict=True))
        lines.append(f"camera {name}: its sensor is tilted by {x} about x and {y} about y")
    return lines
