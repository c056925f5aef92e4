"""Checks of arguments that Python callers pass: arrays, images, ranges. Errors name the argument and the fix."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from beltscape.core.checks import describe_kind, is_array, is_mapping, show_value
from beltscape.core.errors import InputError

if TYPE_CHECKING:
    from beltscape.core.depth import DepthMap
    from beltscape.core.geometry.camera import Camera


def require_image(image: Any, argument: str) -> None:
    """Raise InputError unless ``image`` is (H, W) or (H, W, 3), uint8 or uint16."""
    if not is_array(image):
        raise InputError(f"{argument} is {describe_kind(image)}: must be a NumPy array, uint8 or uint16")
    if image.dtype not in (np.dtype(np.uint8), np.dtype(np.uint16)):
        fix = (
            "; scale it to counts, for an image of 0 to 1: np.rint(65535 * image).astype(np.uint16)"
            if image.dtype.kind == "f"
            else ""
        )
        raise InputError(f"{argument} is {image.dtype}: must be uint8 or uint16{fix}")
    if not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)) or 0 in image.shape:
        raise InputError(f"{argument} has the shape {image.shape}: must be (H, W) grey or (H, W, 3) RGB")


def require_images(images: Any) -> None:
    """Raise InputError unless ``images`` maps camera names to images."""
    if not is_mapping(images):
        raise InputError(f"images is {describe_kind(images)}: must be images by camera, {{'cam0': image, …}}")
    for name, image in images.items():
        require_image(image, f"images[{show_value(name)}]")


def require_depth_range(depth_range_mm: Any) -> None:
    """Raise InputError unless (near, far) are two distances in mm, 0 < near < far."""
    try:
        near, far = (float(value) for value in depth_range_mm)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"depth_range_mm = {show_value(depth_range_mm)}: must be (near, far) in mm"
        ) from error
    if not (np.isfinite([near, far]).all() and 0 < near < far):
        raise InputError(
            f"depth_range_mm = ({near:g}, {far:g}): must be (near, far) in mm with 0 < near < far"
        )


def require_depth_of(camera: Camera, depth: DepthMap, what: str) -> None:
    """Raise InputError unless all arrays of ``depth`` have the camera's size; ``what`` names the map in the error."""
    width, height = camera.size_px
    for name in ("depth_mm", "sigma_mm", "views", "confidence"):
        values = getattr(depth, name, None)
        if not is_array(values):
            raise InputError(
                f"{what}: depth is {describe_kind(depth)} without the array {name}: must be a DepthMap"
            )
        if values.shape != (height, width):
            size = "×".join(str(n) for n in values.shape[::-1])
            raise InputError(
                f"{what}: the depth map is {size}, the core camera {width}×{height}; give the depth and the rig of "
                "one reconstruction"
            )
