"""Intrinsics of single cameras: from views that each takes on its own, or given and matched by name and size."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.assessment.cross_validation import list_folds
from beltscape.calibration.assessment.lens_domain import describe_domains, limit_domain
from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.detection.detect_capture import detect_board
from beltscape.calibration.hierarchy import EXCESS_FACTOR, EXCESS_PX, HierarchyResult
from beltscape.calibration.intrinsics.lens_choice import (
    AUTO,
    LensChoice,
    calibrate_with_model,
    describe_choices,
)
from beltscape.calibration.intrinsics.sensitivity import NOISE_FLOOR_PX
from beltscape.calibration.intrinsics.zhang import MonocularCalibration, calibrate_camera, set_up_adjustment
from beltscape.calibration.solver.lens import LensPrior, compute_lens_prior, list_parameters
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
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    """Lens models that were compared with others, and lenses that are known in a part of the image only."""

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
    board_mm = corner_points_mm(board.unplace() if isinstance(board, BoardSet) else board)
    monocular: dict[str, MonocularCalibration] = {}
    choices: list[LensChoice] = []
    failures: list[str] = []
    with single_thread():
        for done, name in enumerate(detections.cameras, start=1):
            try:
                monocular[name], choice = calibrate_with_model(name, detections, board_mm, lens_model)
                choices.append(choice)
            except CalibrationError as error:
                failures.append(str(error))
            reporter.step("calibrating cameras", done, len(detections.cameras))
        if not monocular:
            raise CalibrationError(f"{capture.folder}: {failures[0]}")
        for line in failures:
            reporter.warn(f"{line}; going on without this camera")
        held_out = {
            name: _score_held_out(calibration.camera, detections, board_mm)
            for name, calibration in monocular.items()
        }
        covariances = {
            name: compute_lens_covariance(detections, calibration, board_mm)
            for name, calibration in monocular.items()
        }
    for name, calibration in monocular.items():
        _warn_of_views(name, calibration, held_out[name], reporter)
    monocular = {name: _limit_domain(each, detections) for name, each in monocular.items()}
    lenses = {name: each.camera for name, each in monocular.items()}
    return IntrinsicsCalibration(
        capture, detections, monocular, held_out, covariances, tuple(reporter.warnings),
        (*describe_choices(choices), *describe_domains(lenses)),
    )  # fmt: skip


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


def _score_held_out(camera: Camera, detections: BoardDetections, board_mm: Array) -> float:
    """Return the RMS of the views of each fold under the lens from the other folds; NaN with too few views."""
    own = detections.restrict((camera.name,), detections.views[camera.name])
    for folds in list_folds(own, tuple(own.views[camera.name])):
        try:
            squares = [_sum_squares(camera, own, fold, board_mm) for fold in folds]
        except CalibrationError:
            continue
        total, count = np.sum(squares, axis=0)
        return float(np.sqrt(total / count))
    return float("nan")


def _sum_squares(
    camera: Camera, detections: BoardDetections, fold: tuple[str, ...], board_mm: Array
) -> tuple[float, int]:
    """Return the sum of squared errors of a fold's corners under the lens from the other views, and their number."""
    name = camera.name
    others = detections.restrict((name,), set(detections.views[name]) - set(fold))
    lens = calibrate_with_model(name, others, board_mm, camera.model)[0].camera
    test = detections.restrict((name,), fold)
    fitted = calibrate_camera(name, test, board_mm, known=lens, min_views=1)
    counts = {frame: len(corners) for frame, corners in test.views[name].items()}
    squares = sum(counts[frame] * rms**2 for frame, rms in fitted.view_rms_px.items())
    return squares, sum(counts[frame] for frame in fitted.view_rms_px)


def compute_lens_covariance(
    detections: BoardDetections, calibration: MonocularCalibration, board_mm: Array
) -> Array:
    """Return the covariance (W, W) of a camera's intrinsics from the noise of its corners; 0 for fixed ones.

    With few corners far off the axis the coefficients of a rational lens are free but for the prior of lenses.
    """
    camera, views = calibration.camera, detections.views[calibration.camera.name]
    used = {frame: views[frame] for frame in calibration.cam_from_board}
    corners = sum(len(view) for view in used.values())
    bundle, state = set_up_adjustment(
        used, camera, list(calibration.cam_from_board.values()), board_mm,
        prior=compute_lens_prior(camera), fixed=calibration.fixed,
        sigma_px=_estimate_noise_px(calibration, corners),
    )  # fmt: skip
    own = bundle.linearise(state).covariance()
    covariance = np.zeros((bundle.width, bundle.width))
    covariance[np.ix_(bundle.free, bundle.free)] = (own + own.T) / 2
    return covariance


def _estimate_noise_px(calibration: MonocularCalibration, corners: int) -> float:
    """Return the noise of a corner's coordinate from the residuals, with the degrees of freedom of lens and poses."""
    fitted = len(list_parameters(calibration.camera.model)) + 6 * len(calibration.cam_from_board)
    freedom = max(2 * corners - fitted, 1)
    return max(calibration.rms_px * float(np.sqrt(corners / freedom)), NOISE_FLOOR_PX)


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
