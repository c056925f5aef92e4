"""The paper's method: each auxiliary is matched with the core separately; depths are averaged (2.3, Eqs. 21-25)."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import cast

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arguments import require_depth_range
from beltscape.core.depth import DepthMap
from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.core.runtime.system_calls import count_usable_cores
from beltscape.stereo.cameras import check_auxiliaries, list_usable_auxiliaries
from beltscape.stereo.multiview.initialisation.depth_range import find_depth_range
from beltscape.stereo.pairwise.contrast import take_square_root
from beltscape.stereo.pairwise.fusion import fuse_depths
from beltscape.stereo.pairwise.settings import PairwiseSettings
from beltscape.stereo.pairwise.sgbm import PairMatcher, make_pair_matcher
from beltscape.stereo.pairwise.sigma import estimate_sigma


class PairwiseReconstructor:
    """The pairwise matcher for one rig and depth range; it reconstructs any number of frames."""

    def __init__(
        self,
        rig: Rig,
        depth_range_mm: tuple[float, float],
        settings: PairwiseSettings,
        *,
        auxiliaries: tuple[str, ...] | None = None,
    ) -> None:
        """Prepare ``auxiliaries`` (all of the rig by default) for surfaces within (near, far) in mm.

        Raises
        ------
        ReconstructionError
            When there is no auxiliary, one is not in the rig, or a pair cannot be rectified.
        """
        require_depth_range(depth_range_mm)
        names = check_auxiliaries(rig, auxiliaries)
        settings = settings.revalidate()
        self.rig = rig
        self.depth_range_mm = depth_range_mm
        self.settings = settings
        with ThreadPoolExecutor(settings.threads or count_usable_cores()) as pool:
            make_matcher = partial(make_pair_matcher, rig, depth_range_mm=depth_range_mm, settings=settings)
            matchers = pool.map(make_matcher, names)
            self._matchers: Mapping[str, PairMatcher] = dict(zip(names, matchers, strict=True))

    def reconstruct(self, frame_set: FrameSet, reporter: Reporter) -> DepthMap:
        """Return the depth map of one frame; auxiliaries without an image are left out.

        Raises
        ------
        ReconstructionError
            When the core's image or every auxiliary's is missing.
        """
        core = self.rig.core
        names = list_usable_auxiliaries(self.rig, frame_set, tuple(self._matchers))
        core_root = take_square_root(frame_set.images[core])

        def match(name: str) -> NDArray[np.float32]:
            return self._matchers[name].compute_depth(core_root, take_square_root(frame_set.images[name]))

        depths: list[NDArray[np.float32]] = []
        with ThreadPoolExecutor(self.settings.threads or count_usable_cores()) as pool:
            for depth in pool.map(match, names):
                depths.append(depth)
                reporter.step(f"matching {frame_set.frame}", len(depths), len(names))
        pairs = [self._matchers[name].pair for name in names]
        scale = float(np.mean([pair.focal_px * pair.baseline_mm for pair in pairs]))
        agreement = self.settings.agreement_px
        fused = fuse_depths(np.stack(depths), None if agreement is None else agreement / scale)
        confidence = fused.views / np.float32(len(names))  # the share of pairs that agree
        return DepthMap(
            fused.depth_mm, estimate_sigma(fused, scale), fused.views, cast("NDArray[np.float32]", confidence)
        )


def reconstruct_pairwise(
    rig: Rig,
    frame_set: FrameSet,
    settings: PairwiseSettings,
    reporter: Reporter,
    *,
    auxiliaries: tuple[str, ...] | None = None,
    depth_range_mm: tuple[float, float] | None = None,
) -> DepthMap:
    """Return the depth map of one frame by the paper's method; for many frames use `PairwiseReconstructor`.

    Parameters
    ----------
    rig
        The calibrated rig.
    frame_set
        Images of one trigger instant; auxiliaries may be missing.
    settings
        Settings of the matcher.
    reporter
        Receives the progress after each pair.
    auxiliaries
        Auxiliaries to use, all by default; a single one is the paper's binocular method.
    depth_range_mm
        (near, far) along the core's optical axis; by default found from the images.

    Raises
    ------
    ReconstructionError
        When the core's image or every auxiliary's is missing, or no pair can be rectified.

    References
    ----------
    Hou, Kang & Qiao, Sensors 2025, 25(7), 2111, doi:10.3390/s25072111, section 2.3, Eqs. 21-25.
    """
    names = list_usable_auxiliaries(rig, frame_set, auxiliaries)
    if depth_range_mm is None:
        depth_range_mm = find_depth_range(rig, frame_set, reporter, settings.threads)
    matcher = PairwiseReconstructor(rig, depth_range_mm, settings, auxiliaries=names)
    return matcher.reconstruct(frame_set, reporter)


def find_horizontal_auxiliary(rig: Rig) -> str:
    """Return the auxiliary whose baseline is closest to the core image's u axis: the paper's binocular set-up.

    Raises
    ------
    ReconstructionError
        When the rig has no auxiliary.
    """
    if not rig.auxiliaries:
        raise ReconstructionError(f"the rig has only its core camera {rig.core}; depth needs a second one")
    return max(rig.auxiliaries, key=lambda name: _cosine_with_u(rig, name))


def _cosine_with_u(rig: Rig, name: str) -> float:
    """Return |cos| of the angle between an auxiliary's baseline and the core image's u axis."""
    baseline = rig.cam_from_core[name].center_mm
    return float(abs(baseline[0]) / np.linalg.norm(baseline))
