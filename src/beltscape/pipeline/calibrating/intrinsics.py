"""Intrinsics of single cameras: from views that each takes on its own, or given and matched by name and size."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.assessment.covariance import compute_camera_covariance, compute_formal_covariance
from beltscape.calibration.assessment.cross_validation import list_folds
from beltscape.calibration.assessment.lens_domain import describe_domains, limit_domain
from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.detection.detect_capture import detect_board
from beltscape.calibration.hierarchy import EXCESS_FACTOR, EXCESS_PX, HierarchyResult
from beltscape.calibration.intrinsics.lens_choice import (
    AUTO,
    calibrate_with_model,
    describe_choices,
)
from beltscape.calibration.intrinsics.zhang import MonocularCalibration, calibrate_camera
from beltscape.calibration.lens_review import (
    MIN_SHAPE_VIEWS,
    ReviewedCamera,
    review_camera,
    set_up_alone,
)
from beltscape.calibration.solver.lens import LensPrior
from beltscape.calibration.solver.levenberg_marquardt import single_thread
from beltscape.core.arrays import Array
from beltscape.core.errors import CalibrationError, InputError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.lens import list_intrinsics
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import RecordingReporter, Reporter
from beltscape.files.capture import Capture
from beltscape.files.exchange import RIG_JSON, detect_format, read_intrinsics
from beltscape.files.intrinsics_json import (
    Intrinsics,
    is_intrinsics_file,
    read_intrinsics_file,
    write_intrinsics,
)
from beltscape.files.paths import AnyPath, as_path
from beltscape.files.rig_json import read_rig
from beltscape.pipeline.calibrating.views import has_board_views, read_board_views, split_boards
from beltscape.target.board import Board, BoardSet, corner_points_mm

MAX_HELD_OUT_RATIO, MAX_EXCESS_PX = 1.5, 0.1
"""Ratio of a camera's held-out RMS to that in training, and px more, above which its views do not determine its lens:
those of `beltscape.calibration.assessment.findings`."""


@dataclass(frozen=True, slots=True, eq=False)
class IntrinsicsCalibration:
    """Lenses of the cameras of a capture, each from its own views."""

    capture: Capture
    detections: BoardDetections
    monocular: Mapping[str, MonocularCalibration]
    held_out_px: Mapping[str, float]
    """By camera: RMS over folds of the views, each under the lens from the others; NaN with too few views."""
    covariances: Mapping[str, Array]
    """(W, W) by camera, of fx, fy, cx, cy and the coefficients."""
    board_off_drawing_mm: Mapping[str, Array]
    """By camera: RMS (3,) of the board's corners off their drawing, as its views measured them; 0 if not."""
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    """Lens models that were compared with others, lenses that are known in a part of the image only, bent boards."""

    def to_intrinsics(self) -> Intrinsics:
        """Return the lenses as intrinsics.json holds them."""
        quality = {name: self._describe_quality(name) for name in self.monocular}
        cameras = {name: calibration.camera for name, calibration in self.monocular.items()}
        return Intrinsics(cameras, self.covariances, quality)

    def _describe_quality(self, name: str) -> dict[str, Any]:
        calibration = self.monocular[name]
        return {
            "images": self.detections.images[name],
            "views": len(calibration.cam_from_board),
            "rms_px": calibration.rms_px,
            "held_out_rms_px": self.held_out_px[name],
            "sigma": dict(calibration.sigma),
            "held": calibration.fixed,
            "rejected": dict(calibration.rejected),
            "board_off_drawing_rms_mm": self.board_off_drawing_mm[name].tolist(),
        }


def calibrate_intrinsics(
    folder: AnyPath, board: Board, reporter: Reporter, *, lens_model: str = AUTO
) -> IntrinsicsCalibration:
    """Calibrate each camera of a capture by itself; the views of different cameras need not be of one instant.

    ``folder`` holds a folder of images for each camera, or the images of one camera. ``lens_model`` is that of all
    cameras, or ``auto``: each camera's own views choose it.

    Raises
    ------
    InputError, CalibrationError
        With one line that names the fault and the fix, when no camera can be calibrated.
    """
    reporter = RecordingReporter(reporter)
    capture = read_board_views(as_path(folder, "folder"))
    detections, _ = detect_board(capture, board, reporter)
    detections = split_boards(detections, board)
    cameras: dict[str, ReviewedCamera] = {}
    failures: list[str] = []
    with single_thread():
        for done, name in enumerate(detections.cameras, start=1):
            try:
                cameras[name] = _calibrate_camera(name, detections, board, lens_model)
            except CalibrationError as error:
                failures.append(str(error))
            reporter.step("calibrating cameras", done, len(detections.cameras))
        if not cameras:
            raise CalibrationError(f"{capture.folder}: {failures[0]}")
        for line in failures:
            reporter.warn(f"{line}; going on without this camera")
        held_out = {name: _score_held_out(each, detections, board) for name, each in cameras.items()}
        covariances = {name: _compute_covariance(each, detections, board) for name, each in cameras.items()}
    for name, each in cameras.items():
        _warn_of_views(name, each.monocular, held_out[name], reporter)
    monocular = {
        name: _complete_camera(each.monocular, covariances[name], detections)
        for name, each in cameras.items()
    }
    lenses = {name: each.camera for name, each in monocular.items()}
    shapes = {name: _measure_off_drawing(each) for name, each in cameras.items()}
    return IntrinsicsCalibration(
        capture, detections, monocular, held_out, covariances, shapes, tuple(reporter.warnings),
        (
            *describe_choices([each.choice for each in cameras.values()]),
            *describe_domains(lenses), *_describe_shapes(cameras, shapes, board),
        ),
    )  # fmt: skip


def _calibrate_camera(
    name: str, detections: BoardDetections, board: Board, lens_model: str
) -> ReviewedCamera:
    """Calibrate a camera, and again with the shape of the board that its views measure.

    The views of a set of boards are those of single ones, too few of each for its shape.
    """
    monocular, choice = calibrate_with_model(name, detections, _list_corners_mm(board), lens_model)
    if isinstance(board, BoardSet):
        return ReviewedCamera(monocular, choice)
    return review_camera(detections, monocular, choice, board)


def _list_corners_mm(board: Board) -> Array:
    """Return the corners (P, 3) of the drawn board; those of a set as of single boards."""
    return corner_points_mm(board.unplace() if isinstance(board, BoardSet) else board)


def _get_corners_mm(camera: ReviewedCamera, board: Board) -> Array:
    """Return the corners (P, 3) of the board as a camera measured them."""
    return camera.adjustment.geometry.points_mm if camera.adjustment else _list_corners_mm(board)


def _compute_covariance(camera: ReviewedCamera, detections: BoardDetections, board: Board) -> Array:
    """Return the covariance (W, W) of a camera's intrinsics; that of the board's shape is included."""
    alone = camera.adjustment or set_up_alone(detections, camera.monocular, _list_corners_mm(board))
    return compute_camera_covariance(alone)


def _complete_camera(
    calibration: MonocularCalibration, covariance: Array, detections: BoardDetections
) -> MonocularCalibration:
    """Return the calibration with the σ of its covariance, limited to the part of the image that corners reached."""
    sigma = dict(zip(calibration.sigma, np.sqrt(np.diag(covariance)).tolist(), strict=True))
    return _limit_domain(replace(calibration, sigma=sigma), detections)


def _measure_off_drawing(camera: ReviewedCamera) -> Array:
    """Return the RMS (3,) of the board's corners off their drawing, mm; 0 where no deviation was measured."""
    if camera.adjustment is None:
        return np.zeros(3)
    return np.asarray(np.sqrt((camera.adjustment.shape_mm**2).mean(axis=0)), np.float64)


def _describe_shapes(
    cameras: Mapping[str, ReviewedCamera], shapes: Mapping[str, Array], board: Board
) -> list[str]:
    """Return notes on the board's shape as cameras measured it, and on those whose views are too few for it."""
    lines = [
        f"camera {name}: the board deviates from its drawing by {off[2]:.3f} mm out of plane and "
        f"{np.hypot(off[0], off[1]):.3f} mm in plane (RMS), which its views measured and its lens is corrected for"
        for name, off in shapes.items()
        if np.any(off)
    ]
    few = [name for name, each in cameras.items() if len(each.monocular.cam_from_board) < MIN_SHAPE_VIEWS]
    if few and not isinstance(board, BoardSet):
        lines.append(
            f"camera {', '.join(few)}: with fewer than {MIN_SHAPE_VIEWS} views a bent board cannot be told from the "
            "lens; the board is taken as drawn"
        )
    return lines


def _limit_domain(calibration: MonocularCalibration, detections: BoardDetections) -> MonocularCalibration:
    """Return the calibration with its lens limited to the part of the image that corners of its views reached."""
    views = detections.views[calibration.camera.name]
    reached = np.concatenate([views[frame].pixels for frame in calibration.cam_from_board])
    return replace(calibration, camera=limit_domain(calibration.camera, reached))


def write_intrinsics_calibration(out: Path, calibration: IntrinsicsCalibration) -> Path:
    """Write intrinsics.json into a folder; return its path."""
    path = out / "intrinsics.json"
    write_intrinsics(path, calibration.to_intrinsics())
    return path


def _score_held_out(camera: ReviewedCamera, detections: BoardDetections, board: Board) -> float:
    """Return the RMS of the views of each fold under lens and board from the other folds; NaN with too few views."""
    name = camera.choice.camera
    own = detections.restrict((name,), detections.views[name])
    for folds in list_folds(own, tuple(own.views[name])):
        try:
            squares = [_sum_squares(camera, own, fold, board) for fold in folds]
        except CalibrationError:
            continue
        total, count = np.sum(squares, axis=0)
        return float(np.sqrt(total / count))
    return float("nan")


def _sum_squares(
    camera: ReviewedCamera, detections: BoardDetections, fold: tuple[str, ...], board: Board
) -> tuple[float, int]:
    """Return the sum of squared errors of a fold's corners under the lens from the other views, and their number.

    The board has the shape that the other views measure, or that which all do where the others are too few.
    """
    name = camera.choice.camera
    others = detections.restrict((name,), set(detections.views[name]) - set(fold))
    monocular, choice = calibrate_with_model(
        name, others, _list_corners_mm(board), camera.monocular.camera.model
    )
    board_mm = _get_corners_mm(camera, board)
    if camera.adjustment and not isinstance(board, BoardSet):
        again = review_camera(others, monocular, choice, board)
        monocular = again.monocular
        board_mm = _get_corners_mm(again, board) if again.adjustment else board_mm
    test = detections.restrict((name,), fold)
    fitted = calibrate_camera(name, test, board_mm, known=monocular.camera, min_views=1)
    counts = {frame: len(corners) for frame, corners in test.views[name].items()}
    squares = sum(counts[frame] * rms**2 for frame, rms in fitted.view_rms_px.items())
    return squares, sum(counts[frame] for frame in fitted.view_rms_px)


def compute_lens_covariance(
    detections: BoardDetections, calibration: MonocularCalibration, board_mm: Array
) -> Array:
    """Return the covariance (W, W) of a camera's intrinsics from the noise of its corners; 0 for fixed ones.

    With few corners far off the axis the coefficients of a rational lens are free but for the prior of lenses.
    """
    adjustment = set_up_alone(detections, calibration, board_mm)
    return compute_formal_covariance(adjustment.rig, adjustment.bundle, adjustment.linearise())


def _warn_of_views(
    name: str, calibration: MonocularCalibration, held_out_px: float, reporter: Reporter
) -> None:
    """Warn if the views do not determine the lens, or do not fit it."""
    if np.isnan(held_out_px):
        reporter.warn(
            f"camera {name}: its {len(calibration.cam_from_board)} views are too few for a held-out score; take ten "
            "and more, tilted to every side, that fill the image to its corners"
        )
    elif held_out_px > max(MAX_HELD_OUT_RATIO * calibration.rms_px, calibration.rms_px + MAX_EXCESS_PX):
        reporter.warn(
            f"camera {name}: views that its lens was not calibrated with fit within {held_out_px:.2f} px RMS, the "
            f"others within {calibration.rms_px:.2f} px: they do not determine its lens; take more at other tilts"
        )


IntrinsicsUse = Literal["held", "prior"]


@dataclass(frozen=True, slots=True, eq=False)
class KnownIntrinsics:
    """Cameras with given intrinsics, and their source."""

    cameras: Mapping[str, Camera]
    """By name."""
    source: str = "known"
    """The file, or another name for messages."""
    priors: Mapping[str, LensPrior] = field(default_factory=dict[str, LensPrior])
    """Cameras whose intrinsics are a prior of their adjustment, among ``cameras``; the others are fixed."""

    def match_capture(self, capture: Capture, reporter: Reporter) -> KnownIntrinsics:
        """Return the intrinsics of the capture's cameras; warn of names that only one side has.

        Raises
        ------
        InputError
            When none of them belongs to a camera of the capture.
        """
        held = {name: camera for name, camera in self.cameras.items() if name in capture.cameras}
        if not held:
            raise InputError(
                f"{self.source}: holds intrinsics of {', '.join(self.cameras) or 'no camera'}, {capture.folder} has "
                f"the cameras {', '.join(capture.cameras)}: none is the same; name the cameras in the file as their "
                "folders are named"
            )
        estimated = [name for name in capture.cameras if name not in held]
        unused = [name for name in self.cameras if name not in held]
        if estimated:
            reporter.warn(
                f"{self.source}: gives the intrinsics of {', '.join(held)}; those of {', '.join(estimated)} are "
                f"estimated from the views{_describe_unused(unused)}"
            )
        elif unused:
            reporter.warn(f"{self.source}: also holds {', '.join(unused)}, not in {capture.folder}")
        priors = {name: prior for name, prior in self.priors.items() if name in held}
        return KnownIntrinsics(held, self.source, priors)

    def require_sizes(self, sizes_px: Mapping[str, tuple[int, int]]) -> None:
        """Raise InputError if the size of a camera's images differs from that of its intrinsics."""
        mismatched = [
            name
            for name, camera in self.cameras.items()
            if sizes_px.get(name, camera.size_px) != camera.size_px
        ]
        if mismatched:
            listed = ", ".join(
                f"{name} for {_format_size(self.cameras[name].size_px)} px, "
                f"its images have {_format_size(sizes_px[name])} px"
                for name in mismatched
            )
            raise InputError(
                f"{self.source}: intrinsics of another image size ({listed}); give those of this size"
            )

    def find_foreign(
        self, hierarchy: HierarchyResult, detections: BoardDetections, board: Board
    ) -> dict[str, str]:
        """Return by camera a line for those whose views fit far better with estimated intrinsics."""
        lines: dict[str, str] = {}
        board_mm = corner_points_mm(board)
        for name in self.cameras:
            if name not in hierarchy.monocular:
                continue
            given = hierarchy.monocular[name].rms_px
            try:
                with single_thread():
                    own = calibrate_camera(name, detections, board_mm).rms_px
            except CalibrationError:
                continue
            if given > EXCESS_PX and given > EXCESS_FACTOR * own:
                lines[name] = (
                    f"{self.source}: the intrinsics of {name} fit its views within {given:.2f} px RMS, intrinsics of "
                    f"its own within {own:.2f} px: they are of another camera, lens, focus or crop; give the right "
                    f"ones, or none"
                )
        return lines


def read_known_intrinsics(
    path: Path, board: Board, reporter: Reporter, *, use: IntrinsicsUse = "held"
) -> KnownIntrinsics:
    """Read intrinsics: an intrinsics.json, a rig.json, another program's file, or a folder of board views.

    Of a folder of views, which each camera takes by itself, the intrinsics are calibrated first. ``use`` as ``prior``
    needs covariances, which another program's files lack.

    Raises
    ------
    InputError
        When the file cannot be read, or has no covariances though they are needed.
    """
    intrinsics = _read_intrinsics(path, board, reporter)
    if use == "held":
        return KnownIntrinsics(intrinsics.cameras, str(path))
    without = [name for name in intrinsics.cameras if name not in intrinsics.covariances]
    if without:
        raise InputError(
            f"{path}: holds no covariance of the intrinsics of {', '.join(without)}, which a prior needs; hold them "
            "(--intrinsics-as held), or give an intrinsics.json of beltscape calibrate intrinsics"
        )
    priors = {
        name: LensPrior(camera, intrinsics.covariances[name]) for name, camera in intrinsics.cameras.items()
    }
    return KnownIntrinsics(intrinsics.cameras, str(path), priors)


def _read_intrinsics(path: Path, board: Board, reporter: Reporter) -> Intrinsics:
    if has_board_views(path):
        return calibrate_intrinsics(path, board, reporter).to_intrinsics()
    if is_intrinsics_file(path):
        return read_intrinsics_file(path)
    if path.is_file() and detect_format(path) == RIG_JSON:
        rig = read_rig(path)
        return Intrinsics(rig.cameras, _find_covariances(rig))
    return Intrinsics(read_intrinsics(path, reporter))


def _find_covariances(rig: Rig) -> dict[str, NDArray[np.float64]]:
    """Return the covariances of the intrinsics by camera that a rig.json holds, as far as they are estimates."""
    parameters, matrix = (
        list(rig.covariance.get("parameters", ())),
        np.array(rig.covariance.get("matrix", ())),
    )
    found: dict[str, NDArray[np.float64]] = {}
    for name, camera in rig.cameras.items():
        names = [f"{name}.{parameter}" for parameter in list_intrinsics(camera.model)]
        if matrix.ndim == 2 and all(each in parameters for each in names):
            place = [parameters.index(each) for each in names]
            block = matrix[np.ix_(place, place)]
            if (np.diag(block) > 0).any():
                found[name] = block
    return found


def _describe_unused(names: list[str]) -> str:
    return f"; it also holds {', '.join(names)}, which the capture does not have" if names else ""


def _format_size(size_px: tuple[int, int]) -> str:
    return f"{size_px[0]}×{size_px[1]}"
