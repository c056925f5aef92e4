"""Calibrated rigs: cameras and their poses relative to the core camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.checks import require_instance, show_value
from beltscape.core.display import Displayed
from beltscape.core.errors import ArgumentError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.type_guards import is_mapping


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
        if not isinstance(self.core, str) or self.core not in self.cameras:  # pyright: ignore[reportUnnecessaryIsInstance]
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
