"""Domain of calibrated lenses: the part of the image that the calibration's corners reached.

The tilt of their sensors (Scheimpflug) is described with its standard deviation.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.lens import BROWN
from beltscape.core.geometry.rig import Rig
from beltscape.files.rig_limits import find_corner_radius_px, find_turning_radius_px

TURNING_SHARE = 0.98
"""Share of the turning point's distance up to which a polynomial is used: at the point itself its rays have no
derivative, and their uncertainty is infinite."""

MENTIONED_SHARE = 0.95
"""Share of the distance of the image's farthest corner below which a limit is mentioned."""


def limit_domains(rig: Rig, adjustment: BundleAdjustmentResult, given: Collection[str] = ()) -> Rig:
    """Return the rig whose lenses are used as far from the principal point as corners determined them.

    Brown's polynomial is limited only if it turns back within the image: it extrapolates a long lens well, while
    rational and fisheye lenses of wide views do not stay true beyond the corners. ``given`` lenses stay as they are.
    """
    observations = adjustment.bundle.observations
    cameras: dict[str, Camera] = {}
    for index, (name, camera) in enumerate(rig.cameras.items()):
        used = (observations.camera == index) & adjustment.used
        cameras[name] = camera if name in given else limit_domain(camera, observations.pixels[used])
    return replace(rig, cameras=cameras)


def describe_domains(cameras: Mapping[str, Camera]) -> list[str]:
    """Return a line for every lens that the calibration determined in a part of its image only."""
    lines: list[str] = []
    for name, camera in cameras.items():
        reach_px, corner_px = camera.valid_radius_px, find_corner_radius_px(camera)
        if reach_px is not None and reach_px < MENTIONED_SHARE * corner_px:
            lines.append(
                f"camera {name}: its lens ({camera.model}) is known up to {reach_px:.0f} px from the principal "
                f"point; nothing is measured beyond, up to {corner_px:.0f} px; show the board in the image's corners"
            )
    return lines


def limit_domain(camera: Camera, pixels: np.ndarray) -> Camera:
    """Return the camera whose domain ends at the farthest of its corners (n, 2), px, if its model needs a limit."""
    turning_px, corner_px = find_turning_radius_px(camera), find_corner_radius_px(camera)
    if camera.model == BROWN.name and turning_px > corner_px:
        return camera
    reach_px = float(np.linalg.norm(pixels - camera.center_px, axis=1).max()) if len(pixels) else corner_px
    limit_px = min(reach_px, TURNING_SHARE * turning_px)
    return camera if limit_px >= corner_px else replace(camera, valid_radius_px=round(limit_px, 2))


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
