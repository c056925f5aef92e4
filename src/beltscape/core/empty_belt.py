"""The model of the empty belt: pose, cross-section, edges, and their standard deviations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from beltscape.core.checks import require_array, require_instance, require_like, require_pair
from beltscape.core.display import Displayed
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose

End = Literal["seen", "inferred", "told", "covered", "unmeasured", "out of view"]
"""What is known of an end of the belt across: a step beside it was measured; it follows from the other end and the
width given; it was given; something stands above the belt there; nothing was measured beyond; the image ends."""


@dataclass(frozen=True, slots=True, eq=False)
class BeltDeviation:
    """Deviation of the belt's surface from one constant cross-section, such as the sag between idlers."""

    x_mm: NDArray[np.float64]
    """(Kx,) float64 nodes across, ascending."""
    y_mm: NDArray[np.float64]
    """(Ky,) float64 nodes along, ascending."""
    height_mm: NDArray[np.float64]
    """(Ky, Kx) float64 above the cross-section, linear between the nodes, constant beyond them."""
    sigma_mm: NDArray[np.float64]
    """(Ky, Kx) float64 one standard deviation of it."""

    def interpolate(self, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the height (...,) at x, y (...,), broadcast together; a NaN position gives the first node's."""
        x, y = (np.nan_to_num(part, nan=-np.inf) for part in np.broadcast_arrays(x_mm, y_mm))
        column = np.interp(x, self.x_mm, np.arange(len(self.x_mm)))
        row = np.interp(y, self.y_mm, np.arange(len(self.y_mm)))
        i, j = (
            np.clip(part.astype(np.intp), 0, n - 2) for part, n in zip((row, column), self._size, strict=True)
        )
        down, right = row - i, column - j
        z = self.height_mm
        upper = z[i, j] * (1 - right) + z[i, j + 1] * right
        lower = z[i + 1, j] * (1 - right) + z[i + 1, j + 1] * right
        return upper * (1 - down) + lower * down

    @property
    def _size(self) -> tuple[int, int]:
        return len(self.y_mm), len(self.x_mm)


@dataclass(frozen=True, slots=True)
class BeltEdges:
    """The belt's ends across, at y = 0; NaN where an end was not visible against a background."""

    left_mm: float
    """x of the end at the smaller x."""
    right_mm: float
    """x of the end at the larger x."""
    left_sigma_mm: float
    """One standard deviation of it."""
    right_sigma_mm: float
    """One standard deviation of it."""
    offset_mm: float
    """Offset of the belt towards +x; NaN where the visible ends do not determine it."""
    sigma_mm: float
    """One standard deviation of it."""
    against: Literal["trough", "learned"]
    """Reference of the offset: the middle of the trough, or the ends of the learned belt."""


@dataclass(frozen=True, slots=True, eq=False)
class Belt(Displayed):
    """Pose and shape of the empty belt; x, z in the belt frame."""

    belt_from_core: Pose
    """Into the belt frame: origin where the core's optical axis meets the belt, x across, y along, z up."""
    x_mm: NDArray[np.float64]
    """(K,) float64 nodes across the belt, ascending."""
    z_mm: NDArray[np.float64]
    """(K,) float64 the empty cross-section's height there."""
    across_mm: tuple[float, float]
    """Extent of the belt in x, as far as it was visible."""
    flat_mm: tuple[float, float] | None
    """Ends in x of the flat centre; None for a V-shaped or round trough, which has none."""
    flat_rms_mm: float
    """Robust scatter of the depth map's points about the flat (about the cross-section where there is none)."""
    noise_mm: float
    """Robust scatter of the points about the cross-section, over the whole belt."""
    correlation_px: float
    """Side of the square of neighbouring pixels whose errors are fully correlated, estimated from the scatter."""
    drift_mm: float
    """Scatter that does not average out over areas of a hundred pixels: the depth map's slow errors."""
    tilt_sigma_rad: float
    """One standard deviation of the direction of z."""
    yaw_sigma_rad: float | None
    """One standard deviation of the direction of x; None where the belt does not determine it."""
    yaw_from: Literal["shape", "edges", "told", "camera"]
    """Source of x: the trough's shape, the flat belt's edges, or, without either, the direction of travel that was
    given, or else the core image's u axis."""
    z_sigma_mm: NDArray[np.float64]
    """(K,) float64 one standard deviation of ``z_mm``."""
    along_mm: tuple[float, float]
    """Extent in y over which the belt was visible."""
    deviation: BeltDeviation | None
    """Deviation from the constant cross-section; None where it does not exceed the noise."""
    edges: BeltEdges | None
    """Edges of the belt; None before they were measured."""
    claimed_sigma_mm: float
    """Median σ of the depth map; comparing it with ``noise_mm`` shows how well σ is calibrated."""
    frames: int
    """Number of frames that the model was learned from."""
    camera: Camera | None = None
    """Core camera of the depth maps that it was learned from; None: not known."""
    ends: tuple[End, End] | None = None
    """What is known of the ends ``across_mm``; None: not known, as in files of earlier versions."""
    clear_mm: tuple[float, float] = (-np.inf, np.inf)
    """Range of x beyond which something beside the belt stands as high as it, such as a frame."""
    width_mm: float | None = None
    """Width of the belt along its surface, as given; None: not given."""

    def __post_init__(self) -> None:
        """Raise ArgumentError unless pose, nodes and camera are what they are called."""
        require_instance(self.belt_from_core, Pose, "belt_from_core", "bs.Pose.of(rotation, translation_mm)")
        require_array(self.x_mm, "x_mm", (None,))
        for name in ("z_mm", "z_sigma_mm"):
            require_like(getattr(self, name), name, self.x_mm, "x_mm")
        for name in ("across_mm", "along_mm"):
            require_pair(getattr(self, name), name)
        if self.camera is not None:
            require_instance(self.camera, Camera, "camera", "rig.core_camera")

    def __repr__(self) -> str:
        width = self.across_mm[1] - self.across_mm[0]
        shape = "troughed" if self.yaw_from == "shape" else "flat"
        frames = "1 frame" if self.frames == 1 else f"{self.frames} frames"
        return f"Belt({shape}, {width:.0f} mm wide, from {frames}, noise {self.noise_mm:.3f} mm)"

    @property
    def middle_mm(self) -> float:
        """X of the trough's middle: that of the flat or, without one, of the lowest node."""
        if self.flat_mm is not None:
            return 0.5 * (self.flat_mm[0] + self.flat_mm[1])
        return float(self.x_mm[int(np.argmin(self.z_mm))])

    def height_mm(self, x_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the height of the empty belt's cross-section at any x, constant beyond its ends."""
        return np.interp(x_mm, self.x_mm, self.z_mm)

    def height_at_mm(self, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the height (...,) of the empty belt at points x, y (...,), with its deviation."""
        even = self.height_mm(x_mm)
        return even if self.deviation is None else even + self.deviation.interpolate(x_mm, y_mm)

    def surface_mm(self, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the height (Ny, Nx) of the empty belt at columns x (Nx,) and rows y (Ny,), with its deviation."""
        return np.broadcast_to(self.height_at_mm(x_mm[None], y_mm[:, None]), (len(y_mm), len(x_mm)))

    def surface_sigma_mm(self, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return one standard deviation (Ny, Nx) of ``surface_mm``."""
        even = np.broadcast_to(np.interp(x_mm, self.x_mm, self.z_sigma_mm), (len(y_mm), len(x_mm)))
        if self.deviation is None:
            return even
        spread = BeltDeviation(
            self.deviation.x_mm, self.deviation.y_mm, self.deviation.sigma_mm, self.deviation.sigma_mm
        )
        return np.hypot(even, spread.interpolate(x_mm[None], y_mm[:, None]))
