"""Given intrinsics, matched to the cameras of a capture by name and image size."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.hierarchy import EXCESS_FACTOR, EXCESS_PX, HierarchyResult
from beltscape.calibration.intrinsics.zhang import calibrate_camera
from beltscape.calibration.solver.deterministic import single_thread
from beltscape.calibration.solver.lens_prior import LensPrior
from beltscape.core.errors import CalibrationError, InputError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.lens import list_intrinsics
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.files.capture import Capture
from beltscape.files.exchange import RIG_JSON, detect_format, read_intrinsics
from beltscape.files.intrinsics_json import Intrinsics, is_intrinsics_file, read_intrinsics_file
from beltscape.files.rig_json import read_rig
from beltscape.pipeline.calibrating.intrinsics import calibrate_intrinsics
from beltscape.pipeline.calibrating.views.board_views import has_board_views
from beltscape.target.board import Board, corner_points_mm

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
