"""Calibrated rigs: cameras and their poses relative to the core camera; their scaling to smaller or larger images."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.checks import is_mapping, require_instance, require_number, show_value
from beltscape.core.display import Displayed
from beltscape.core.errors import ArgumentError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose


@dataclass(frozen=True, slots=True, eq=False)
class Rig(Displayed):
    """A calibrated rig; the core camera's ``cam_from_core`` is the identity."""

    core: str
    cameras: Mapping[str, Camera]
    """Cameras by name, the core among them."""
    cam_from_core: Mapping[str, Pose]
    """Pose of each camera by its name; that of the core is the identity."""
    quality: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Figures of the calibration's quality: plain JSON values, units in the keys."""
    covariance: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Covariance of the parameters, if it was estimated: plain JSON values."""

    def __post_init__(self) -> None:
        """Raise ArgumentError unless the core is one of the cameras, and each camera has a pose."""
        for argument, kind in (("cameras", Camera), ("cam_from_core", Pose)):
            values = getattr(self, argument)
            if not is_mapping(values) or not values:
                raise ArgumentError(
                    f"{argument} = {show_value(values)}: must be a {kind.__name__} by the name of each camera"
                )
            for name, value in values.items():
                require_instance(value, kind, f"{argument}[{show_value(name)}]", f"bs.{kind.__name__}(...)")
        if not isinstance(self.core, str) or self.core not in self.cameras:
            raise ArgumentError(
                f"core = {show_value(self.core)}: must be one of the cameras, {', '.join(self.cameras)}"
            )
        if lacking := [name for name in self.cameras if name not in self.cam_from_core]:
            raise ArgumentError(f"cam_from_core has no pose of {', '.join(lacking)}")

    def __repr__(self) -> str:
        width, height = self.core_camera.size_px
        return f"Rig(core {self.core}, {len(self.cameras)} cameras of {width}×{height} px)"

    @property
    def core_camera(self) -> Camera:
        """The camera whose frame results are in."""
        return self.cameras[self.core]

    @property
    def auxiliaries(self) -> tuple[str, ...]:
        """Names of all cameras but the core, in the rig's order."""
        return tuple(name for name in self.cameras if name != self.core)

    @property
    def scale_sigma(self) -> float:
        """Relative standard deviation of all lengths that the rig measures, from the certificate of its board.

        0 where the board's size was taken as exact.
        """
        value = self.quality.get("scale_sigma")
        is_known = isinstance(value, int | float) and np.isfinite(value) and value > 0
        return float(value) if is_known else 0.0

    def relative_pose(self, to: str, origin: str) -> Pose:
        """Return ``to_from_origin`` between any two cameras."""
        return self.cam_from_core[to] @ self.cam_from_core[origin].inverse()

    def project_into(self, other: Rig, name: str, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Project points (N, 3) of the core frame with this rig and undistort the pixels with ``other``.

        Return (N, 2), NaN outside the image. Triangulated with the other rig, they show how the two rigs differ.
        """
        camera, target = self.cameras[name], other.cameras[name]
        pixels = camera.project(self.cam_from_core[name].apply(points_mm))
        inside = ((pixels >= -0.5) & (pixels <= np.array(camera.size_px) - 0.5)).all(axis=1)
        pixels[~inside] = np.nan
        return target.undistort(pixels) * target.focal_px + target.center_px

    def projection(self, name: str) -> NDArray[np.float64]:
        """Return the projection matrix (3, 4), core frame (mm) to undistorted pixels, the paper's M (Eq. 1)."""
        pose = self.cam_from_core[name]
        return self.cameras[name].matrix @ np.column_stack([pose.rotation, pose.translation_mm])


CROPPED = 0.05
"""Relative difference of sizes up to which images are taken for a crop, not for scaled ones (chosen): nobody scales
by 0.98, but regions of interest cut off a few rows or columns."""
KEPT_QUALITY = ("board", "board_corners_mm", "scale_sigma")
"""Entries of a rig's quality that do not depend on the size of the images."""
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
    """Return the rig with all cameras scaled and without the figures of its quality that are in pixels.

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
    return Rig(rig.core, cameras, rig.cam_from_core, _keep_quality(rig))


def fit_camera(camera: Camera, size_px: tuple[int, int]) -> Camera | None:
    """Return the camera for its images binned, reduced or enlarged to a size; None if that has another aspect ratio.

    Binning cuts off the rows and columns that fill no whole bin; the pixels of all others have the exact factor.
    """
    own, size = np.array(camera.size_px), np.array(size_px)
    if (own == size).all():
        return camera
    binning = max(1, round(own[0] / size[0]))
    factors = np.full(2, 1 / binning) if (own // binning == size).all() else size / own
    is_alike = abs(own[1] * size[0] / own[0] - size[1]) <= 1
    if not (is_alike or factors[0] == factors[1]) or abs(size[0] / own[0] - 1) < CROPPED:
        return None
    radius = camera.valid_radius_px
    return replace(
        camera,
        size_px=size_px,
        focal_px=camera.focal_px * factors,
        center_px=(camera.center_px + 0.5) * factors - 0.5,
        valid_radius_px=None if radius is None else radius * float(factors.mean()),
    )


def replace_scaled_cameras(rig: Rig, scaled: Mapping[str, Camera]) -> Rig:
    """Return the rig with scaled cameras and its covariance in their pixels; quality in pixels is left out."""
    cameras = {name: scaled.get(name, camera) for name, camera in rig.cameras.items()}
    return Rig(rig.core, cameras, rig.cam_from_core, _keep_quality(rig), _scale_covariance(rig, cameras))


def _keep_quality(rig: Rig) -> dict[str, Any]:
    """Return what of a rig's quality does not depend on the size of the images."""
    return {key: rig.quality[key] for key in KEPT_QUALITY if key in rig.quality}


def _scale_covariance(rig: Rig, cameras: Mapping[str, Camera]) -> dict[str, Any]:
    """Return the rig's covariance with the pixels of scaled cameras; empty without a valid one."""
    parameters = [str(name) for name in rig.covariance.get("parameters") or ()]
    matrix = np.asarray(rig.covariance.get("matrix") or (), np.float64)
    if matrix.shape != (len(parameters), len(parameters)) or not parameters:
        return {}
    factors = np.ones(len(parameters))
    for i, parameter in enumerate(parameters):
        name, _, quantity = parameter.rpartition(".")
        if name in cameras and quantity in ("fx_px", "fy_px", "cx_px", "cy_px"):
            axis = int(quantity[1] == "y")
            factors[i] = cameras[name].focal_px[axis] / rig.cameras[name].focal_px[axis]
    scaled = matrix * np.outer(factors, factors)
    return {**rig.covariance, "parameters": parameters, "matrix": scaled.tolist()}


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
