"""A world as Mitsuba scenes: colours, light and highlights are rendered separately and combined into one picture."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.simulate.geometry.world import World
from beltscape.simulate.rendering.mitsuba_light import make_emitters
from beltscape.simulate.rendering.mitsuba_scene import Appearance, make_shapes
from beltscape.simulate.rendering.pinhole import Pinhole
from beltscape.simulate.rendering.view import ViewRenderer


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
            pictures.append(view.render_emission(self._emissive, pinhole) * irradiance + specular)
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
