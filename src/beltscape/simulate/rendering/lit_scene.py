"""A world as Mitsuba scenes: colours, light and highlights are rendered separately and combined into one picture.

They are rendered as one camera sees them.
"""

from __future__ import annotations

from functools import cached_property
from math import ceil, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.pose import Pose
from beltscape.simulate.rendering.mitsuba_scene import Appearance, device_to_world, make_emitters, make_shapes
from beltscape.simulate.rendering.optics import Pinhole
from beltscape.simulate.world import World

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


class LitScene:
    """A world as Mitsuba scenes, each built on first use."""

    def __init__(self, mi: Any, world: World, *, texture_filter: str) -> None:
        self._mi, self._world, self._filter = mi, world, texture_filter
        self._glossy = any(solid.gloss > 0 for solid in world.solids)

    def render_paths(
        self, view: ViewRenderer, pinholes: list[Pinhole], bounces: int
    ) -> list[NDArray[np.float32]]:
        """Render each pinhole's picture (h, w, 3) by path tracing, with noise."""
        return [view.render_paths(self._real, pinhole, bounces) for pinhole in pinholes]

    def render_direct(
        self, view: ViewRenderer, pinholes: list[Pinhole], coarse: Pinhole, ambient_samples: int
    ) -> list[NDArray[np.float32]]:
        """Render each pinhole's picture (h, w, 3) of direct light; ambient light is rendered at ``coarse``."""
        ambient = _smooth(view.render_ambient(self._white, coarse, ambient_samples))
        highlights = (
            view.render_ambient(self._highlights, coarse, ambient_samples)[..., :3] if self._glossy else None
        )
        pictures: list[NDArray[np.float32]] = []
        for pinhole in pinholes:
            irradiance = _resample(ambient, coarse, pinhole)
            specular = _resample(highlights, coarse, pinhole) if highlights is not None else np.float32(0)
            if self._world.projector is not None:
                irradiance = irradiance + view.render_projector(self._white, pinhole)
                if self._glossy:
                    specular = specular + view.render_projector(self._highlights, pinhole)
            pictures.append(view.render_emission(self._emissive, pinhole) * irradiance + specular)  # pyrefly: ignore[bad-argument-type]
        return pictures

    @cached_property
    def _real(self) -> Any:
        return self._scene("real", lit=True)

    @cached_property
    def _white(self) -> Any:
        return self._scene("white", lit=True)

    @cached_property
    def _highlights(self) -> Any:
        return self._scene("highlights", lit=True)

    @cached_property
    def _emissive(self) -> Any:
        return self._scene("emissive", lit=False)

    def _scene(self, appearance: Appearance, *, lit: bool) -> Any:
        lights = make_emitters(self._mi, self._world) if lit else {}
        solids = make_shapes(self._mi, self._world.solids, appearance, texture_filter=self._filter)
        return self._mi.load_dict({"type": "scene", **lights, **solids})


def _smooth(ambient: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return (h, w, 3) smoothed light on surfaces from (h, w, 4) light and the share of surface in each pixel."""
    import cv2

    smooth = cv2.GaussianBlur(ambient, (0, 0), 1.0)
    return np.asarray(smooth[..., :3] / np.maximum(smooth[..., 3:], np.float32(1e-6)), np.float32)


def _resample(picture: NDArray[np.float32], source: Pinhole, target: Pinhole) -> NDArray[np.float32]:
    """Resample a coarse pinhole's picture onto another's pixels, as if the scene lay in the plane in focus."""
    import cv2

    middle = np.zeros(1)
    source_px, target_px = np.ravel(source.project(middle, middle)), np.ravel(target.project(middle, middle))
    scale = source.focal_px / target.focal_px
    to_source = np.column_stack([np.eye(2) * scale, source_px - scale * target_px])
    size = (target.crop_px[2], target.crop_px[3])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    fine = cv2.warpAffine(picture, to_source, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(fine, np.float32)
