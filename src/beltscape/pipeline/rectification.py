"""Capture and rig → rectified pairs with a measured check."""

from __future__ import annotations

from collections.abc import Iterator

from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Reporter
from beltscape.core.rig import Rig
from beltscape.sources.folder import FolderSource
from beltscape.stereo.pairwise import usable_auxiliaries
from beltscape.stereo.rectified import RectifiedImages, rectify_images
from beltscape.stereo.rectify import rectify_pair

WARN_ROWS_PX = 0.5
"""Matches farther than this off their rows mean that the rig is not the one that took the images."""


def rectify(
    source: FolderSource, rig: Rig, depth_range_mm: tuple[float, float], reporter: Reporter
) -> Iterator[tuple[FrameSet, list[RectifiedImages]]]:
    """Every frame's pairs about the core camera (the paper's Section 2.3.1)."""
    pairs = {
        name: rectify_pair(rig, name, depth_range_mm) for name in rig.auxiliaries if name in source.cameras
    }
    for done, frame_set in enumerate(source, start=1):
        try:
            names = usable_auxiliaries(rig, frame_set, tuple(pairs))
        except ReconstructionError as error:
            reporter.warn(f"{error}; going on without this frame")
            continue
        images = [rectify_images(frame_set, pairs[name]) for name in names]
        for each in images:
            if each.rows.rms_px > WARN_ROWS_PX:
                reporter.warn(
                    f"frame {frame_set.frame}: {rig.core} and {each.pair.auxiliary} are "
                    f"{each.rows.rms_px:.2f} px off their common rows; the camera moved or the rig is another's: calibrate again"
                )
        reporter.step("rectifying", done, len(source))
        yield frame_set, images
