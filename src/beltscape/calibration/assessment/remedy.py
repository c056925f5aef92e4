"""Remedies for views that determine no rig: what they lack, and what to photograph.

The advice names the true lack: frames that two cameras share, the board's size in the images, its positions, or its
tilts.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from beltscape.calibration.assessment.covariance import count_positions
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.calibration.hierarchy import HierarchyResult
from beltscape.core.arrays import Array

ENOUGH_POSITIONS = 10
"""Positions of the board that determine a rig if it is tilted, large and seen in all parts of the images; the manual
advises as many."""
TILTED = "tilted about 30° to every side, near and far and in all parts of every image"
PHOTOGRAPH = f"photograph the board in {ENOUGH_POSITIONS} positions or more, {TILTED}"
SMALL_SHARE = 0.25
"""Median size of the board over the image's width below which it is too small: the perspective that determines a
focal length grows with the square of this share. A board that fills half of the image is advised."""
FEW_SHARED = 4
"""Frames shared by two cameras up to which their number is named as the cause; five give a rig of two cameras."""


@dataclass(frozen=True, slots=True)
class BoardSize:
    """Size of the board in the images."""

    board_px: float
    """Median over the views of the larger side of the rectangle around the corners."""
    image_px: float
    """Median width of the images."""

    @property
    def is_small(self) -> bool:
        """True if the board is too small in the images for its perspective to be measured."""
        return self.board_px < SMALL_SHARE * self.image_px

    def describe(self) -> str:
        """Return the size as a cause, and the fix."""
        return (
            f"the board is only {self.board_px:.0f} px wide in images {self.image_px:.0f} px wide: bring it nearer, "
            f"or take a larger one, so that it fills half of an image, {TILTED}"
        )


def measure_boards(views: Iterable[tuple[Array, tuple[int, int]]]) -> BoardSize:
    """Return the size of the board in views, each given by its corners (n, 2), px, and the image's size."""
    sides, widths = zip(*((float(np.ptp(px, axis=0).max()), size[0]) for px, size in views), strict=True)
    return BoardSize(float(np.median(sides)), float(np.median(widths)))


def describe_undetermined(hierarchy: HierarchyResult) -> str:
    """Return why the views of a hierarchy determine no rig, and what to photograph, in one line."""
    reason = "the views do not determine the rig"
    paths = [set(path) for path in hierarchy.network.paths.values()]
    needed = [p for p in hierarchy.network.pairs if any({p.first, p.second} <= path for path in paths)]
    few = min(needed, key=lambda pair: len(pair.frames))
    if len(few.frames) <= FEW_SHARED:
        return (
            f"{reason}: cameras {few.first} and {few.second} share only {len(few.frames)} usable views of the board "
            f"({', '.join(few.frames)}); show it to both at the same instant: {PHOTOGRAPH}"
        )
    seen = hierarchy.detections
    size = measure_boards((c.pixels, seen.sizes_px[n]) for n, own in seen.views.items() for c in own.values())
    return f"{reason}: {size.describe()}" if size.is_small else f"{reason}; {PHOTOGRAPH}"


def advise_views(adjustment: BundleAdjustmentResult) -> str:
    """Return the views that an adjustment had, why they do not suffice, and what to photograph."""
    positions, size = count_positions(adjustment), _measure_adjusted_boards(adjustment)
    tilt_deg = _find_tilt_deg(adjustment)
    seen = f"{positions} position{'s' * (positions != 1)} of the board, tilted by {tilt_deg:.0f}° at most"
    if size.is_small:
        return f"{seen}, do not suffice, for {size.describe()}"
    if positions < ENOUGH_POSITIONS:
        return f"{seen}, do not suffice; {PHOTOGRAPH}"
    return f"{seen}, do not suffice; photograph the board {TILTED}, beside the present positions"


def _find_tilt_deg(adjustment: BundleAdjustmentResult) -> float:
    """Return the largest tilt of the board against a camera that sees it."""
    observed, geometry = adjustment.bundle.observations, adjustment.geometry
    views = np.unique(np.stack([observed.camera, observed.frame])[:, adjustment.used], axis=1)
    normals = np.einsum(
        "nij,nj->ni", geometry.cam_rotation[views[0]], geometry.board_rotation[views[1]][:, :, 2]
    )
    return float(np.degrees(np.arccos(np.abs(normals[:, 2]).min().clip(0, 1))))


def _measure_adjusted_boards(adjustment: BundleAdjustmentResult) -> BoardSize:
    observed, cameras = adjustment.bundle.observations, list(adjustment.rig.cameras.values())
    return measure_boards(
        (observed.pixels[rows], cameras[camera].size_px)
        for rows, camera in zip(adjustment.bundle.views, adjustment.bundle.view_camera, strict=True)
    )
