"""The result of a calibration: the rig with everything that is known of its quality."""

from __future__ import annotations

from dataclasses import dataclass

from beltscape.calibration.assessment.covariance import DepthSigma, RigCovariance
from beltscape.calibration.assessment.coverage import Coverage
from beltscape.calibration.assessment.diagnosis import Discards
from beltscape.calibration.assessment.fit_quality import FitQuality
from beltscape.calibration.assessment.next_best_view import NextBestView
from beltscape.calibration.assessment.score import RigErrors, Score
from beltscape.calibration.assessment.worst_depth import explain_worst_depth
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.detection.detector import PrintVariant
from beltscape.calibration.hierarchy import HierarchyResult
from beltscape.core.geometry.rig import Rig
from beltscape.files.capture import Capture
from beltscape.target.board import Board


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Result of calibrating a capture."""

    capture: Capture
    board: Board
    variant: PrintVariant
    detections: BoardDetections
    hierarchy: HierarchyResult
    adjustment: BundleAdjustmentResult
    rig: Rig
    """The final rig, with its scores and its covariance."""
    covariance: RigCovariance
    depth_sigma: tuple[DepthSigma, ...]
    """σ of depth from the calibration at the nearest, middle and farthest boards."""
    depth_sigma_by_views: tuple[DepthSigma, ...]
    """The same by clusters of views, which does not take the corners of a view as independent."""
    next_best_view: NextBestView | None
    """The most useful further view."""
    rig_errors: RigErrors
    training: Score
    """Score on the views that the rig was calibrated with; it is optimistic."""
    held_out: Score | None
    """Score on views that the rig was not calibrated with; None if the views are too few."""
    fit: FitQuality
    """Assessment of the fit by its own residuals."""
    given: tuple[str, ...]
    """Cameras whose intrinsics were given."""
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    """Remarks that are no faults: what looked like one before the joint adjustment, pixels that are not square."""
    discards: Discards
    """Corners, views and frames that the rig was not found from."""
    coverage: Coverage
    """Coverage of the measuring volume by the board's views."""

    @property
    def score(self) -> Score:
        """The score on views that the rig was not calibrated with; with too few views, the optimistic one."""
        return self.held_out or self.training

    @property
    def worst_depth(self) -> str | None:
        """Where σ of depth is largest at the middle boards, why, and the fix; None if it is even over the view."""
        return explain_worst_depth(self.rig, self.adjustment, self.covariance.matrix, self.depth_sigma[1])

    def __repr__(self) -> str:
        kind = "held-out" if self.held_out else "training"
        return f"Calibration({self.rig!r}, {kind} RMS {self.score.rms_px:.3f} px)"
