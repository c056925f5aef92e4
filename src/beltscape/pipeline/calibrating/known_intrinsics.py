"""Given intrinsics, matched to the cameras of a capture by name and image size."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from beltscape.calibrate.detection.corners import BoardDetections
from beltscape.calibrate.hierarchy import EXCESS_FACTOR, EXCESS_PX, HierarchyResult
from beltscape.calibrate.intrinsics.zhang import calibrate_camera
from beltscape.calibrate.solver.deterministic import single_thread
from beltscape.core.errors import CalibrationError, InputError
from beltscape.core.geometry.camera import Camera
from beltscape.core.progress import Reporter
from beltscape.files.capture import Capture
from beltscape.target.board import Board, corner_points_mm


@dataclass(frozen=True, slots=True, eq=False)
class KnownIntrinsics:
    """Cameras with given intrinsics, and their source."""

    cameras: Mapping[str, Camera]
    """By name."""
    source: str = "known"
    """The file, or another name for messages."""

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
        return KnownIntrinsics(held, self.source)

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


def _describe_unused(names: list[str]) -> str:
    return f"; it also holds {', '.join(names)}, which the capture does not have" if names else ""


def _format_size(size_px: tuple[int, int]) -> str:
    return f"{size_px[0]}×{size_px[1]}"
