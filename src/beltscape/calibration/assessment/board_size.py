"""The size of a board by its certificate, where this gives a standard deviation for each of its two directions.

The adjustment measures how much longer a print's rows are than its columns, and no length. With independent
certificates of the two, that difference says which of them is off, and by how much: it has their covariance with the
mean of the two as its gain. A certificate that is common to both directions leaves the size as it is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from beltscape.calibration.assessment.board_print import compute_corner_covariance, measure_print
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.calibration.solver.prior import PRINT_STRETCH
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.target.board import Board, BoardSet, PlanarBoard

MOST_SIGMAS = 4.0
"""A stretch that exceeds its standard deviation by this factor contradicts the certificate."""


@dataclass(frozen=True, slots=True)
class CertifiedSize:
    """Size of a board and of its rig against the drawing."""

    factor: float
    """All lengths over those of the rig that has the drawing's size in the mean of both directions."""
    sigma: float
    """Relative standard deviation of all lengths."""
    contradiction: str = ""
    """What contradicts the certificate; empty: nothing."""

    def resize(self, rig: Rig) -> Rig:
        """Return a rig of the drawing's size with the cameras at the distances of this one."""
        poses = {
            name: Pose(pose.rotation, self.factor * pose.translation_mm)
            for name, pose in rig.cam_from_core.items()
        }
        return replace(rig, cam_from_core=poses)


def estimate_board_size(board: Board, adjustment: BundleAdjustmentResult, inflation: float) -> CertifiedSize:
    """Return the size of the board; ``inflation`` is that of σ by views' scatter."""
    if isinstance(board, BoardSet) or board.axis_sigma is None:
        return CertifiedSize(1.0, board.scale_sigma)
    rows, columns = np.square(board.axis_sigma)
    share = _compute_share_of_rows(board)
    mean, stretch = share**2 * rows + (1 - share) ** 2 * columns, rows + columns
    both = share * rows - (1 - share) * columns
    if not np.any(adjustment.shape_mm[:, :2]):
        return CertifiedSize(1.0, float(np.sqrt(mean)))
    covariance = inflation**2 * compute_corner_covariance(adjustment)
    found = measure_print(board, adjustment.geometry.points_mm, covariance)
    value, variance = _remove_prior(found.stretch, found.stretch_sigma**2)
    gain = both / (stretch + variance)
    text = ""
    if abs(value) > MOST_SIGMAS * np.sqrt(stretch + variance):
        text = (
            f"the board's rows are {value:+.2%} ± {np.sqrt(variance):.2%} longer than its columns, but its "
            f"certificate allows ± {np.sqrt(stretch):.2%}: measure a long row and a long column again"
        )
    return CertifiedSize(1.0 + float(gain * value), float(np.sqrt(mean - gain * both)), text)


def _compute_share_of_rows(board: PlanarBoard) -> float:
    """Return the share that an error of the rows' lengths has in the board's size as the adjustment holds it."""
    x, y = board.corners_mm().T
    return float(x.var() / (x.var() + y.var()))


def _remove_prior(value: float, variance: float) -> tuple[float, float]:
    """Return a stretch and its variance without the adjustment's prior, `PRINT_STRETCH`."""
    rest = 1 / variance - PRINT_STRETCH**-2
    return (value, variance) if rest <= 0 else (value / (variance * rest), 1 / rest)
