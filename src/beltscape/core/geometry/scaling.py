"""Scaling of cameras and rigs to smaller or larger images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from beltscape.core.checks import require_instance, require_number, show_value
from beltscape.core.errors import ArgumentError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.rig import Rig

_MOST_PX = 1 << 17
"""No image is wider or higher: four times the largest sensors of 2026 and their line scans."""


def scale_camera(camera: Camera, factor: float) -> Camera:
    """Return the camera with ``factor`` times the pixels per side; (0, 0) stays the centre of the top-left pixel."""
    size = tuple(round(side * factor) for side in camera.size_px)
    factors = np.array(size) / np.array(camera.size_px)
    return replace(
        camera,
        size_px=(size[0], size[1]),
        focal_px=camera.focal_px * factors,
        center_px=(camera.center_px + 0.5) * factors - 0.5,
        valid_radius_px=None
        if camera.valid_radius_px is None
        else camera.valid_radius_px * float(factors.mean()),
    )


def scale_rig(rig: Rig, factor: float) -> Rig:
    """Return the rig with all cameras scaled and without its quality, whose figures are in pixels.

    >>> half = bs.scale_rig(rig, 0.5)
    >>> half.core_camera.size_px
    (306, 256)

    Raises
    ------
    InputError
        if ``factor`` is no number above 0, or leaves no pixel of a camera.
    """
    require_instance(rig, Rig, "rig", "bs.read_rig(path)")
    require_number(factor, "factor", 0.0, above=True)
    for name, camera in rig.cameras.items():
        if not all(0.5 < side * factor < _MOST_PX for side in camera.size_px):
            width, height = camera.size_px
            raise ArgumentError(
                f"factor = {show_value(factor)}: {name}'s image of {width}×{height} px cannot have that size"
            )
    cameras = {name: scale_camera(camera, factor) for name, camera in rig.cameras.items()}
    return Rig(rig.core, cameras, rig.cam_from_core)


def pinhole_scale(camera: Camera, other: Camera) -> float | None:
    """Return the factor that scales the pinhole of ``camera`` to that of ``other``; None if there is none.

    Depth maps lie on the undistorted pinhole grid of the core camera, so the distortion is not compared: a
    belt.json holds the grid alone.
    """
    factor = other.size_px[0] / camera.size_px[0]
    expected = scale_camera(camera, factor)
    # rows that do not divide evenly are cut off, which moves the principal point by up to half a pixel
    is_same = (
        abs(expected.size_px[1] - other.size_px[1]) <= 1
        and np.allclose(expected.focal_px, other.focal_px, rtol=2e-3)
        and np.allclose(expected.center_px, other.center_px, atol=0.6)
    )
    return factor if is_same else None
