"""Warnings of the camera faults that were found when a frame was reconstructed."""

from __future__ import annotations

from beltscape.core.progress import Reporter
from beltscape.files.reconstruction import FrameResult


def warn_of_camera_faults(frame: FrameResult, reporter: Reporter) -> None:
    """Warn of a frame's camera faults; their systematic error is included in its depth map's σ."""
    for line in frame.faults:
        reporter.warn(f"{frame.folder}: {line}")
