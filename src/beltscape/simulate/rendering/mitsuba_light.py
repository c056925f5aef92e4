"""Light as Mitsuba emitters: the diffuse ambient light of the hall and the projector.

A white diffuse surface in the open yields 1 under ambient light of 1, and `Projector.power` at 1000 mm under a
white pixel.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import InputError
from beltscape.core.geometry.pose import Pose
from beltscape.simulate.geometry.world import Projector, World


def make_emitters(mi: Any, world: World) -> dict[str, Any]:
    """Return entries of a scene dictionary."""
    entries: dict[str, Any] = {}
    if world.projector is not None:
        entries["projector"] = _make_projector(mi, world.projector)
    # Without sampling weight no ray is aimed at the ambient light, only reflected into it: there is no noise where
    # nothing occludes it, and all aimed rays sample the projector. As the only emitter it needs a weight.
    entries["hall"] = {
        "type": "constant",
        "radiance": float(world.ambient),
        "sampling_weight": 0.0 if entries else 1.0,
    }
    return entries


def device_to_world(mi: Any, device_from_world: Pose) -> Any:
    """Return Mitsuba's transform of a camera or projector: x points left, y up, z along the view."""
    matrix = np.eye(4)
    matrix[:3, :3] = device_from_world.rotation.T * [-1.0, -1.0, 1.0]
    matrix[:3, 3] = device_from_world.center_mm
    return mi.ScalarTransform4f(matrix)


def _make_projector(mi: Any, projector: Projector) -> dict[str, Any]:
    camera = projector.camera
    width, height = camera.size_px
    if np.any(camera.distortion):
        raise InputError(
            f"projector {camera.name}: its lens is assumed to be free of distortion; set it to zero"
        )
    if projector.pattern.shape != (height, width, 3):
        raise InputError(
            f"projector {camera.name}: the pattern's shape is {projector.pattern.shape}, not ({height}, {width}, 3)"
        )
    # a border of one black texel, because the nearest texel is repeated outside the frame
    texture = np.pad(np.float32(projector.pattern), ((1, 1), (1, 1), (0, 0)))
    half_width, to_uv = _symmetric_frustum(camera.focal_px, camera.center_px, (width + 2, height + 2))
    return {
        "type": "projector",
        "to_world": device_to_world(mi, projector.projector_from_world),
        "fov": float(np.rad2deg(2 * np.arctan(half_width))),
        "fov_axis": "x",
        # irradiance at 1 mm; Mitsuba multiplies by π, and a white surface reflects 1/π of it as radiance
        "scale": float(projector.power) * 1000.0**2,
        "irradiance": {
            "type": "bitmap",
            "data": mi.TensorXf(texture),
            "raw": True,
            "filter_type": "bilinear",
            "wrap_mode": "clamp",
            "to_uv": mi.ScalarTransform3f(to_uv),
        },
    }


def _symmetric_frustum(
    focal_px: NDArray[np.float64], center_px: NDArray[np.float64], size_px: tuple[int, int]
) -> tuple[float, NDArray[np.float64]]:
    """Return the half width x/z of Mitsuba's symmetric frustum, and (3, 3) its uv → uv of the bordered pattern."""
    size = np.array(size_px, dtype=np.float64)
    center = center_px + 1.5  # from the outer corner of the border
    reach = np.maximum(center, size - center) / focal_px
    half_width = max(reach[0], reach[1] * size[0] / size[1])
    half = np.array([half_width, half_width * size[1] / size[0]])
    to_uv = np.eye(3)
    to_uv[[0, 1], [0, 1]] = 2 * half * focal_px / size
    to_uv[:2, 2] = (center - half * focal_px) / size
    return float(half_width), to_uv
