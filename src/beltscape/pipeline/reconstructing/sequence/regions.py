"""The control picture of the regions between the projected markers of a frame."""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import blake2b
from pathlib import Path

import cv2
import numpy as np

from beltscape.core.frames import FrameSet, Image
from beltscape.core.geometry.rig import Rig
from beltscape.files.rasters.images import write_image
from beltscape.report.regions import draw_regions
from beltscape.stereo.markers.correspondence import align_grids
from beltscape.stereo.markers.grid import MarkerGrid, detect_marker_grid

_WIDEST_PX = 1600
"""Widest picture; three cameras beside each other stay legible at this width."""
_MOST_KEPT = 64
"""Largest number of images whose grids are kept, chosen: a scene or two of the largest rigs; a grid takes 1 kB."""
_kept: dict[bytes, MarkerGrid | None] = {}
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
    if key in _kept:
        return _kept[key]
    grid = detect_marker_grid(image)
    while len(_kept) >= _MOST_KEPT:
        _kept.pop(next(iter(_kept)), None)
    _kept[key] = grid
    return grid
