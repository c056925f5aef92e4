"""The matcher behind the checks of images: what it is given, and what is said where nothing can be matched."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.core.errors import ReconstructionError
from beltscape.core.findings import Finding
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Reporter, Silent
from beltscape.files.rig_json import read_rig
from beltscape.health.images.monitor import ImageMonitor
from beltscape.health.settings import HealthSettings
from beltscape.pipeline.reconstructing.monitored_matcher import MonitoredMatcher
from tests.synthetic.demo import TRUE_RIG


class Refusing:
    """A matcher that refuses every frame."""

    is_inconsistent = False
    findings: tuple[Finding, ...] = ()

    def reconstruct(self, frame_set: FrameSet, reporter: Reporter) -> DepthMap:
        raise ReconstructionError(f"frame {frame_set.frame}: only {', '.join(frame_set.images)}")


@pytest.mark.parametrize("names", [("cam0",), ("cam1", "cam2")])
def test_too_few_images_without_a_fault_are_named_by_the_matcher(names: tuple[str, ...]) -> None:
    rig = read_rig(TRUE_RIG)
    noise = np.random.default_rng(1).integers(0, 255, rig.core_camera.size_px[::-1], dtype=np.uint8)
    textured = cv2.GaussianBlur(noise, (0, 0), 1.5)
    matcher = MonitoredMatcher(Refusing(), ImageMonitor(rig, HealthSettings()))
    with pytest.raises(ReconstructionError, match=f"^frame 7: only {', '.join(names)}$"):
        matcher.reconstruct(FrameSet("7", dict.fromkeys(names, textured)), Silent())
