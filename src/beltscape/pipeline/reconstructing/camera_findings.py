"""What a reconstructed frame said against its cameras, repeated by every command that measures it."""

from __future__ import annotations

from beltscape.core.progress import Reporter
from beltscape.files.reconstruction import FrameResult


def warn_of_findings(frame: FrameResult, reporter: Reporter) -> None:
    """Warn of the frame's doubts; their systematic error is in its depth map's σ."""
    for line in frame.doubts:
        reporter.warn(f"{frame.folder}: {line}")
