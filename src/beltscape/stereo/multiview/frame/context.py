"""The context of a match: the rig, the grid, the kernels and the window sizes that all stages share."""

from __future__ import annotations

from dataclasses import dataclass

from beltscape.core.geometry.rig import Rig
from beltscape.kernels import Kernels
from beltscape.stereo.multiview.frame.inverse_depth import compute_inverse_depth_scale
from beltscape.stereo.multiview.frame.windows import Windows, choose_windows


@dataclass(frozen=True, slots=True, eq=False)
class MatchContext:
    """Rig, grid, kernels and window sizes that every stage uses on one grid."""

    rig: Rig
    auxiliaries: tuple[str, ...]
    """Names of the auxiliary cameras that are matched with the core."""
    step: int
    """Side of a grid pixel in image pixels."""
    kernels: Kernels
    threads: int
    """Number of threads; 0 takes one per processor core."""
    windows: Windows

    @classmethod
    def for_grid(
        cls, rig: Rig, auxiliaries: tuple[str, ...], step: int, kernels: Kernels, threads: int
    ) -> MatchContext:
        """Return the context of the grid whose pixels average blocks of ``step`` image pixels."""
        windows = choose_windows(rig.core_camera.size_px[0] // step)
        return cls(rig, auxiliaries, step, kernels, threads, windows)

    @property
    def scale(self) -> float:
        """Factor of all distances in px; 1 on a grid as wide as half the paper's images."""
        return self.windows.scale

    @property
    def inverse_depth_scale(self) -> float:
        """Unit of s on this grid, 1/mm."""
        return compute_inverse_depth_scale(self.rig, self.auxiliaries, self.step)

    def halve(self) -> MatchContext:
        """Return the context of the next coarser grid."""
        return self.for_grid(self.rig, self.auxiliaries, 2 * self.step, self.kernels, self.threads)
