"""Findings of a coverage in words: what the board never reached, and what to photograph."""

from __future__ import annotations

import numpy as np

from beltscape.calibration.assessment.domain.coverage import Coverage, Mask
from beltscape.core.errors import CalibrationError

MAX_LOST, MAX_LOST_OF_VIEW = 0.02, 0.25
"""Largest share of unusable points of a given volume, and of the core's whole view, of which an unknown belt may fill
the middle only."""
MIN_REMARK, MIN_REMARK_OF_VIEW = 0.005, 0.02
"""Share of uncertain points from which a gap is remarked on."""
OFF_CENTRE = 0.25
"""Mean offset of a gap from the image's middle, in half images, from which it lies on one side."""


class UncoveredVolumeError(CalibrationError):
    """The board never reached a part of the images that the measuring volume needs."""

    def __init__(self, line: str, coverage: Coverage) -> None:
        """Keep the coverage, of which a picture is drawn."""
        super().__init__(line)
        self.coverage = coverage


def require_coverage(coverage: Coverage) -> None:
    """Raise UncoveredVolumeError if depth cannot be measured in a part of the volume for lack of board views."""
    if coverage.share(coverage.is_unusable) > (MAX_LOST if coverage.volume.is_given else MAX_LOST_OF_VIEW):
        raise UncoveredVolumeError(_describe(coverage, coverage.is_unusable), coverage)


def list_coverage_findings(coverage: Coverage) -> list[str]:
    """Return a line about a gap in the coverage; empty without one."""
    least = MIN_REMARK if coverage.volume.is_given else MIN_REMARK_OF_VIEW
    return (
        [_describe(coverage, coverage.is_uncertain)] if coverage.share(coverage.is_uncertain) > least else []
    )


def _describe(coverage: Coverage, gap: Mask) -> str:
    """Return the gap in one line: the cameras, its size and place, what it costs, and what to photograph."""
    counts = {
        name: int((gap & np.isfinite(each.pixels[:, 0]) & (each.is_beyond | ~each.is_reached)).sum())
        for name, each in coverage.cameras.items()
    }
    worst = max(counts, key=lambda name: counts[name])
    own = coverage.cameras[worst]
    hidden = gap & np.isfinite(own.pixels[:, 0]) & (own.is_beyond | ~own.is_reached)
    others = [name for name in counts if name != worst and counts[name] > 0.3 * counts[worst]]
    also = f" (so too {', '.join(others)})" if others else ""
    seen = int(np.isfinite(own.pixels[:, 0]).sum())
    depth_mm = float(np.median(coverage.volume.points_mm[hidden, 2]))
    return (
        f"camera {worst}: the board never came to {hidden.sum() / max(seen, 1):.0%} of the part of its image that "
        f"sees {coverage.volume.name}{also}, where {_describe_cost(coverage, gap)}; photograph the board "
        f"{_describe_place(own.pixels[hidden], own.camera.size_px)} of {worst}'s image, about {depth_mm:.0f} mm away"
    )


def _describe_cost(coverage: Coverage, gap: Mask) -> str:
    known = gap & np.isfinite(coverage.sigma_px)
    sigma = np.where(known, coverage.sigma_px, 0.0)
    if 2 * known.sum() < gap.sum():
        return "its lens is not known and nothing is measured"
    at = int(np.argmax(sigma))
    return (
        f"the lens is extrapolated and a depth uncertain by up to {coverage.sigma_mm[at]:.2g} mm "
        f"({coverage.sigma_px[at]:.2g} px)"
    )


def _describe_place(pixels: np.ndarray, size_px: tuple[int, int]) -> str:
    """Return where pixels (n, 2) lie in the image, as in "at the upper left"."""
    across, down = (2 * (pixels / (np.array(size_px) - 1) - 0.5)).mean(axis=0).tolist()
    row = "" if abs(down) < OFF_CENTRE else "upper" if down < 0 else "lower"
    column = "" if abs(across) < OFF_CENTRE else "left" if across < 0 else "right"
    if not row and not column:
        return "at all edges and corners"
    place = " ".join(word for word in (row, column) if word)
    return f"at the {place}" if row and column else f"at the {place} edge"
