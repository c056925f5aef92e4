"""Rendering of Mitsuba scenes as one camera sees them."""

from __future__ import annotations

from math import ceil, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.pose import Pose
from beltscape.simulate.rendering.mitsuba_light import device_to_world
from beltscape.simulate.rendering.pinhole import Pinhole

# a fixed block size: Mitsuba seeds each block and would otherwise choose the size by the number of threads
_FIXED_BLOCKS = {"hide_emitters": True, "block_size": 32}
_EMISSION = {"type": "path", "max_depth": 1, "block_size": 32}
_PROJECTOR = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0, **_FIXED_BLOCKS}
_AMBIENT = {"type": "direct", "emitter_samples": 0, "bsdf_samples": 1, **_FIXED_BLOCKS}
_PIXEL_CENTRE = {"type": "stratified", "jitter": False, "sample_count": 1}
_ONE_RANDOM = {"type": "independent", "sample_count": 1}


class ViewRenderer:
    """Renders scenes from the pose of one camera.

    A picture is (h, w, 3) float32 linear RGB. With one sample per pixel the order of summation does not matter.
    """

    def __init__(self, mi: Any, cam_from_world: Pose, seeds: np.random.Generator) -> None:
        self._mi, self._pose, self._seeds = mi, cam_from_world, seeds

    def render_emission(self, scene: Any, pinhole: Pinhole) -> NDArray[np.float32]:
        """Render emitted light at the exact centre of each pixel, without noise."""
        return self._render(scene, pinhole, _EMISSION, _PIXEL_CENTRE)

    def render_projector(self, scene: Any, pinhole: Pinhole) -> NDArray[np.float32]:
        """Render the projector's light reflected once, at the exact centre of each pixel, without noise."""
        return self._render(scene, pinhole, _PROJECTOR, _PIXEL_CENTRE)

    def render_ambient(self, scene: Any, pinhole: Pinhole, samples: int) -> NDArray[np.float32]:
        """Render the ambient light reflected once, from ``samples`` rays per pixel.

        (h, w, 4); the last channel is the share of the pixel that shows a surface.
        """
        return self._render(scene, pinhole, _AMBIENT, _multijitter(samples), alpha=True)

    def render_paths(self, scene: Any, pinhole: Pinhole, bounces: int) -> NDArray[np.float32]:
        """Render all light by random paths."""
        path = {"type": "path", "max_depth": bounces + 2, "rr_depth": 1000, **_FIXED_BLOCKS}
        return self._render(scene, pinhole, path, _ONE_RANDOM)

    def _render(
        self,
        scene: Any,
        pinhole: Pinhole,
        integrator: dict[str, Any],
        sampler: dict[str, Any],
        *,
        alpha: bool = False,
    ) -> NDArray[np.float32]:
        mi = self._mi
        picture = mi.render(
            scene,
            sensor=mi.load_dict(self._describe_sensor(pinhole, sampler, alpha=alpha)),
            integrator=mi.load_dict(integrator),
            seed=int(self._seeds.integers(2**32)),
        )
        return np.array(picture, dtype=np.float32)

    def _describe_sensor(self, pinhole: Pinhole, sampler: dict[str, Any], *, alpha: bool) -> dict[str, Any]:
        (width, height), (left, top, crop_width, crop_height) = pinhole.film_px, pinhole.crop_px
        hole = Pose(np.eye(3), -np.array([*pinhole.lens_mm, 0.0]))
        return {
            "type": "perspective",
            "fov": pinhole.fov_deg,
            "fov_axis": "x",
            "principal_point_offset_x": -pinhole.shift_px[0] / width,
            "principal_point_offset_y": -pinhole.shift_px[1] / height,
            "near_clip": 1.0,
            "far_clip": 1e5,
            "to_world": device_to_world(mi=self._mi, device_from_world=hole @ self._pose),
            "sampler": sampler,
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


def _multijitter(samples: int) -> dict[str, Any]:
    side = ceil(sqrt(samples))
    return {"type": "multijitter", "sample_count": side * side}
