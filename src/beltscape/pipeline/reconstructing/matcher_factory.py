"""The matcher of each method of `reconstruct`, made for a set of auxiliaries in any process."""

from __future__ import annotations

from dataclasses import dataclass

from beltscape.core.geometry.rig import Rig
from beltscape.pipeline.reconstructing.match_pool import FrameMatcher
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.multiview.settings import MultiviewSettings
from beltscape.stereo.pairwise.reconstructor import PairwiseReconstructor
from beltscape.stereo.pairwise.settings import PairwiseSettings


@dataclass(frozen=True, slots=True, eq=False)
class MatcherFactory:
    """Makes matchers of one rig with the same settings, whose type is the method's."""

    rig: Rig
    depth_range_mm: tuple[float, float]
    settings: MultiviewSettings | PairwiseSettings

    def __call__(self, auxiliaries: tuple[str, ...]) -> FrameMatcher:
        """Return the matcher of a set of auxiliaries."""
        if isinstance(self.settings, PairwiseSettings):
            return PairwiseReconstructor(
                self.rig, self.depth_range_mm, self.settings, auxiliaries=auxiliaries
            )
        return MultiviewReconstructor(self.rig, self.depth_range_mm, self.settings, auxiliaries=auxiliaries)
