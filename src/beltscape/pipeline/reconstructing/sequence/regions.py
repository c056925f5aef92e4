"""The control picture of the regions between the projected markers of a frame."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.files.rasters.images import write_image
from beltscape.report.regions import draw_regions
from beltscape.stereo.markers.correspondence import detect_marker_grids

_WIDEST_PX = 1600
"""Widest picture; three cameras beside each other stay legible at this width."""


def write_regions(path: Path, frame_set: FrameSet, rig: Rig, cameras: Sequence[str]) -> Path | None:
    """Draw the marker grids of these cameras, as `detect_marker_grids` gives them; without any, return None.

    Markers count as detected when the core and another camera see them consistently with the rig. A pattern without
    markers, or no pattern, causes no warning.

    Raises
    ------
    OutputError
        When the picture cannot be written.
    """
    images = {name: frame_set.images[name] for name in cameras if name in frame_set.images}
    shown = FrameSet(frame_set.frame, images)
    grids = detect_marker_grids(shown, rig, Silent())
    if rig.core not in grids or len(grids) < 2:
        return None
    picture = draw_regions(shown, grids)
    factor = min(1.0, _WIDEST_PX / picture.shape[1])
    small = cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    write_image(path, np.asarray(small, np.uint8))
    return path
