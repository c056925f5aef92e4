"""Writing of reconstructed frames in the background, while the next ones are matched.

The control picture shows the regions between the projected markers of a frame.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from types import TracebackType
from typing import Any

import cv2
import numpy as np

from beltscape.core.findings import Finding
from beltscape.core.frames import FrameSet, Image
from beltscape.core.geometry.rig import Rig
from beltscape.files.images import write_image
from beltscape.files.reconstruction import write_frame
from beltscape.files.rig_json import write_rig
from beltscape.pipeline.reconstructing.checked_matcher import CheckedDepth
from beltscape.report.control_pictures import draw_regions
from beltscape.report.drawing.depth_picture import draw_depth_map
from beltscape.stereo.consistency.rig_consistency import make_consistency_document
from beltscape.stereo.markers.grid import MarkerGrid, align_grids, detect_marker_grid
from beltscape.stereo.pointcloud import CloudBuilder

_WIDEST_PX = 1600
"""Widest picture; three cameras beside each other stay legible at this width."""
_MOST_KEPT_GRIDS = 64
"""Largest number of images whose grids are kept, chosen: a scene or two of the largest rigs; a grid takes 1 kB."""
_kept_grids: dict[bytes, MarkerGrid | None] = {}
"""Digest of an image → its grid: a capture that is reconstructed by several methods is searched for markers once."""


def write_regions(path: Path, frame_set: FrameSet, rig: Rig, cameras: Sequence[str]) -> Path | None:
    """Draw the marker grids of these cameras in a common numbering; without any, return None.

    Markers count as detected when the core and another camera see them consistently with the rig. A pattern without
    markers, or no pattern, causes no warning.

    Raises
    ------
    OutputError
        When the picture cannot be written.
    """
    images = {name: frame_set.images[name] for name in cameras if name in frame_set.images}
    shown = FrameSet(frame_set.frame, images)
    grids = _detect_grids(shown, rig)
    if rig.core not in grids or len(grids) < 2:
        return None
    picture = draw_regions(shown, grids)
    factor = min(1.0, _WIDEST_PX / picture.shape[1])
    small = cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    write_image(path, np.asarray(small, np.uint8))
    return path


def _detect_grids(frame_set: FrameSet, rig: Rig) -> dict[str, MarkerGrid]:
    """Return the cameras' grids in a common numbering; empty without one in the core camera, whose grid all need."""
    if rig.core not in frame_set.images or (core := _detect_grid(frame_set.images[rig.core])) is None:
        return {}
    detected = {
        name: core if name == rig.core else _detect_grid(frame_set.images[name])
        for name in rig.cameras
        if name in frame_set.images
    }
    return align_grids({name: grid for name, grid in detected.items() if grid is not None}, rig)


def _detect_grid(image: Image) -> MarkerGrid | None:
    """Return the grid of an image, detected or kept from before; None without a grid."""
    key = blake2b(f"{image.shape} {image.dtype}".encode() + image.tobytes()).digest()
    if key in _kept_grids:
        return _kept_grids[key]
    grid = detect_marker_grid(image)
    while len(_kept_grids) >= _MOST_KEPT_GRIDS:
        _kept_grids.pop(next(iter(_kept_grids)), None)
    _kept_grids[key] = grid
    return grid


_THREADS = 2
"""One for the frames' files and one for the picture of the regions; both together take a tenth of the matching."""
_WAITING = 2
"""Frames that may wait to be written; a slow disk then holds up the matching, and memory stays bounded."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One reconstructed frame."""

    frame_set: FrameSet
    checked: CheckedDepth
    health: tuple[Finding, ...] = ()
    """The findings about its images."""


class FrameWriter:
    """Writes rig.json, regions.png and a folder per frame into a reconstruction's folder; a context manager."""

    def __init__(self, out: Path, rig: Rig, cameras: tuple[str, ...]) -> None:
        """Prepare the cloud's rays; ``cameras`` are those whose markers regions.png shows."""
        self._out, self._rig, self._cameras = out, rig, cameras
        self._pool = ThreadPoolExecutor(_THREADS)
        self._builder = self._pool.submit(CloudBuilder, rig.core_camera)
        self._pending: deque[Future[Mapping[str, Any]]] = deque()
        self._regions: Future[Path | None] | None = None
        self.documents: list[Mapping[str, Any]] = []
        """The results of the frames that were written, in order, as plain values for JSON."""

    def __enter__(self) -> FrameWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._pool.shutdown(cancel_futures=error is not None)

    def add(self, frame: Frame) -> None:
        """Begin to write a frame, and complete frames before it.

        Raises
        ------
        OutputError
            When a file of this or an earlier frame cannot be written.
        """
        if self._regions is None:
            write_rig(self._out / "rig.json", self._rig)
            picture = self._out / "regions.png"
            self._regions = self._pool.submit(
                write_regions, picture, frame.frame_set, self._rig, self._cameras
            )
        folder = self._out / frame.frame_set.frame
        self._pending.append(self._pool.submit(lambda: _write(folder, frame, self._builder.result())))
        self._complete(_WAITING)

    def finish(self) -> Path | None:
        """Complete every frame; return regions.png, or None if no markers were detected. Errors as `add`."""
        self._complete(0)
        return None if self._regions is None else self._regions.result()

    def _complete(self, waiting: int) -> None:
        """Take the documents of frames that are written, and wait until at most ``waiting`` are not."""
        while self._pending and (len(self._pending) > waiting or self._pending[0].done()):
            self.documents.append(self._pending.popleft().result())


def _write(folder: Path, frame: Frame, builder: CloudBuilder) -> Mapping[str, Any]:
    checked, image = frame.checked, frame.frame_set.images[builder.camera.name]
    depth = checked.depth
    write_frame(folder, depth, builder.build(depth, image), draw_depth_map(depth), builder.undistort(image))
    measured = depth.measured.any()
    return {
        "frame": frame.frame_set.frame,
        "folder": folder,
        "coverage": depth.coverage,
        "median_depth_mm": float(np.nanmedian(depth.depth_mm)) if measured else float("nan"),
        "median_sigma_mm": float(np.nanmedian(depth.sigma_mm)) if measured else float("nan"),
        "auxiliaries": checked.auxiliaries,
        "systematic_mm": depth.systematic_mm,
        "doubts": checked.faults,
        "consistency": checked.consistency and make_consistency_document(checked.consistency),
        "health": [_make_finding_document(finding) for finding in frame.health],
    }


def _make_finding_document(finding: Finding) -> Mapping[str, Any]:
    return {
        "check": finding.check,
        "camera": finding.subject,
        "value": finding.value,
        "sigma": finding.sigma,
        "limit": finding.limit,
        "unit": finding.unit,
        "effect": finding.effect,
        "text": finding.text,
    }
