"""What a pinhole sees of a Mitsuba scene."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.pose import Pose
from beltscape.simulate.mitsuba_light import to_world
from beltscape.simulate.pinhole import Pinhole

# a fixed block, because Mitsuba seeds each block and would fit its size to the number of threads
_STEADY = {"hide_emitters": True, "block_size": 32}
_SHINE = {"type": "path", "max_depth": 1, "block_size": 32}
_LAMP = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0, **_STEADY}
_HALL = {"type": "direct", "emitter_samples": 0, "bsdf_samples": 1, **_STEADY}


class View:
    """A place from which scenes are looked at.

    Each picture, (h, w, 3) float32 linear RGB, takes one sample per pixel, so that no order of adding matters.
    """

    def __init__(self, mi: Any, cam_from_world: Pose, seeds: np.random.Generator) -> None:
        self._mi, self._pose, self._seeds = mi, cam_from_world, seeds

    def shine(self, scene: Any, pinhole: Pinhole) -> NDArray[np.float32]:
        """What shines by itself, in the very centre of each pixel: without noise."""
        return self._picture(scene, pinhole, _SHINE, centred=True)

    def projected(self, scene: Any, pinhole: Pinhole) -> NDArray[np.float32]:
        """The projector's light that comes back at once, in the very centre of each pixel: without noise."""
        return self._picture(scene, pinhole, _LAMP, centred=True)

    def hall(self, scene: Any, pinhole: Pinhole, samples: int) -> NDArray[np.float32]:
        """The hall's light that comes back at once, from so many rays per pixel.

        (h, w, 4), the last being the share of the pixel where there is a surface.
        """
        total = self._picture(scene, pinhole, _HALL, centred=False, alpha=True)
        for _ in range(samples - 1):
            total += self._picture(scene, pinhole, _HALL, centred=False, alpha=True)
        return total / np.float32(samples)

    def scattered(self, scene: Any, pinhole: Pinhole, bounces: int) -> NDArray[np.float32]:
        """All light, along random paths."""
        path = {"type": "path", "max_depth": bounces + 2, "rr_depth": 1000, **_STEADY}
        return self._picture(scene, pinhole, path, centred=False)

    def _picture(
        self, scene: Any, pinhole: Pinhole, how: dict[str, Any], *, centred: bool, alpha: bool = False
    ) -> NDArray[np.float32]:
        mi = self._mi
        picture = mi.render(
            scene,
            sensor=mi.load_dict(self._sensor(pinhole, centred=centred, alpha=alpha)),
            integrator=mi.load_dict(how),
            spp=1,
            seed=int(self._seeds.integers(2**32)),
        )
        return np.array(picture, dtype=np.float32)

    def _sensor(self, pinhole: Pinhole, *, centred: bool, alpha: bool) -> dict[str, Any]:
        (width, height), (left, top, crop_width, crop_height) = pinhole.film_px, pinhole.crop_px
        hole = Pose(np.eye(3), -np.array([*pinhole.lens_mm, 0.0]))
        sampler = {"type": "stratified", "jitter": False} if centred else {"type": "independent"}
        return {
            "type": "perspective",
            "fov": pinhole.fov_deg,
            "fov_axis": "x",
            "principal_point_offset_x": -pinhole.shift_px[0] / width,
            "principal_point_offset_y": -pinhole.shift_px[1] / height,
            "near_clip": 1.0,
            "far_clip": 1e5,
            "to_world": to_world(mi=self._mi, device_from_world=hole @ self._pose),
            "sampler": {**sampler, "sample_count": 1},
            "film": {
                "type": "hdrfilm",
                "width": width,
                "height": height,
                "crop_offset_x": left,
                "crop_offset_y": top,
                "crop_width": crop_width,
                "crop_height": crop_height,
                "pixel_format": "rgba" if alpha else "rgb",
                "component_format": "float32",
                "rfilter": {"type": "box"},
            },
        }
