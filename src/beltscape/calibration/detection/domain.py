"""Corners within the domains of given lenses: a pixel beyond the domain has no ray and is not used."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from beltscape.calibration.detection.corners import BoardDetections, Corners
from beltscape.core.geometry.camera import Camera
from beltscape.target.planar_boards import MIN_CORNERS


def drop_beyond_domains(detections: BoardDetections, cameras: Mapping[str, Camera]) -> BoardDetections:
    """Return the detections without the corners of ``cameras`` that lie beyond their lens's domain of validity.

    Views that keep fewer corners than a detection needs are left out.
    """
    views = {
        name: _restrict_views(own, cameras[name]) if name in cameras else own
        for name, own in detections.views.items()
    }
    return replace(detections, views=views)


def _restrict_views(views: Mapping[str, Corners], camera: Camera) -> Mapping[str, Corners]:
    within = {
        frame: corners.select(np.isfinite(camera.undistort(corners.pixels)[:, 0]))
        for frame, corners in views.items()
    }
    return {frame: corners for frame, corners in within.items() if len(corners) >= MIN_CORNERS}
