"""Detected board corners, the data of every calibration.

Corners outside the domain of a given lens have no ray and are not used.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.camera import Camera
from beltscape.files.camera_types import CameraType
from beltscape.target.planar_boards import MIN_CORNERS


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """Corners of one board detected in one image."""

    ids: NDArray[np.int64]
    """(n,) index of the corner on the board, ascending."""
    pixels: NDArray[np.float64]
    """(n, 2) position in the distorted image."""
    from_behind: bool = False
    """Whether the board was detected in the mirrored image only: seen from behind, or by a camera that mirrors."""

    def __len__(self) -> int:
        return len(self.ids)

    def select(self, mask: NDArray[np.bool_]) -> Corners:
        """Return the corners of a mask (n,)."""
        return Corners(self.ids[mask], self.pixels[mask], self.from_behind)


@dataclass(frozen=True, slots=True, eq=False)
class BoardDetections:
    """All detected corners of a capture, by camera and frame; views without a usable board are absent."""

    sizes_px: Mapping[str, tuple[int, int]]
    """camera → (width, height)."""
    views: Mapping[str, Mapping[str, Corners]]
    """camera → frame → corners."""
    images: Mapping[str, int]
    """camera → number of images searched."""
    types: Mapping[str, CameraType] = field(default_factory=dict[str, CameraType])
    """camera → what is known of it without images; cameras of one type have like lenses."""

    @property
    def cameras(self) -> tuple[str, ...]:
        """All cameras, with or without views."""
        return tuple(self.sizes_px)

    @property
    def frames(self) -> tuple[str, ...]:
        """Frames in which at least one camera sees the board, in the capture's order."""
        return tuple(dict.fromkeys(frame for views in self.views.values() for frame in views))

    def restrict(self, cameras: Iterable[str], frames: Iterable[str]) -> BoardDetections:
        """Return the detections of some cameras and frames."""
        kept, wanted = tuple(cameras), set(frames)
        return BoardDetections(
            {name: self.sizes_px[name] for name in kept},
            {name: {f: c for f, c in self.views[name].items() if f in wanted} for name in kept},
            {name: self.images[name] for name in kept},
            self.types,
        )

    def find_shared_corners(
        self, first: str, second: str
    ) -> dict[str, tuple[NDArray[np.int64], NDArray[np.int64]]]:
        """Return frame → ids that relate the two cameras: of the corners that both see, else of all that each sees.

        Cameras that see different faces or sides of one object have no corner in common.
        """
        shared: dict[str, tuple[NDArray[np.int64], NDArray[np.int64]]] = {}
        for frame, corners in self.views[first].items():
            other = self.views[second].get(frame)
            if other is not None:
                ids = np.intersect1d(corners.ids, other.ids)
                shared[frame] = (ids, ids) if ids.size else (corners.ids, other.ids)
        return shared


def has_planar_extent(points: NDArray[np.float64]) -> bool:
    """Return whether points (n, 2) or (n, 3) are not (nearly) collinear, as a pose requires."""
    if len(points) < 4:
        return False
    singular_values = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(singular_values[1] > 0.05 * singular_values[0])


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
