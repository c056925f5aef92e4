"""Rendering of a world for its cameras: the light on every pixel, before any sensor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal
from zlib import crc32

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.errors import InputError
from beltscape.simulate.geometry.world import Station, World
from beltscape.simulate.rendering.engine import Engine, load_mitsuba
from beltscape.simulate.rendering.lit_scene import LitScene
from beltscape.simulate.rendering.optics import Lens, Optics
from beltscape.simulate.rendering.view import ViewRenderer


class RenderSettings(BaseModel):
    """Sampling of the rendering."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    oversample: Annotated[int, Field(ge=1, le=8)] = 2
    """Sub-samples per pixel, in each direction."""
    passes: Annotated[int, Field(ge=1, le=256)] = 3
    """Interleaved sets of such sub-samples; Fibonacci numbers (2, 3, 5, 8, 13) interleave best."""
    ambient_samples: Annotated[int, Field(ge=1, le=256)] = 4
    """Rays per pixel that sample the ambient light; rounded up to a square."""
    bounces: Annotated[int, Field(ge=0, le=8)] = 0
    """Maximum number of reflections from surface to surface before the light reaches a camera. 0 is direct light
    only, without noise in the projector's light; more are sampled at random and need many passes.
    """
    texture_filter: Literal["nearest", "bilinear"] = "nearest"
    """Filter of solids' textures: sharp texels, or interpolated ones."""
    engine: Engine = "scalar"
    """One engine gives the same bytes for the same scene with any number of threads; between kinds of processors the
    last bits of the light may differ. `auto` chooses by the machine."""


def render(
    world: World,
    station: Station,
    optics: Mapping[str, Optics],
    settings: RenderSettings | None = None,
    *,
    seed: int = 0,
    share: tuple[int, int] = (0, 1),
) -> dict[str, NDArray[np.float32]]:
    """Return the light per camera, (H, W, 3) float32 linear RGB; 1 is a white surface under ambient light of 1.

    Parameters
    ----------
    world
        The solids and the light.
    station
        The cameras.
    optics
        By camera name; a camera without optics is not rendered.
    settings
        The sampling.
    seed
        Of the light paths: each frame needs its own. The result is the same for any number of threads.
    share
        (index, count): this is picture ``index`` of ``count`` that are averaged; their sub-samples interleave.

    Raises
    ------
    InputError
        If a solid, the projector or a camera cannot be rendered.
    SettingsError
        If the engine is not installed.
    """
    settings = settings or RenderSettings()
    for name in optics:
        if name not in station.rig.cameras:
            raise InputError(
                f"optics of {name}: the rig has no such camera; it has {', '.join(station.rig.cameras)}"
            )
    mi = load_mitsuba(settings.engine)
    scene = LitScene(mi, world, texture_filter=settings.texture_filter)
    images: dict[str, NDArray[np.float32]] = {}
    for name, camera_optics in optics.items():
        lens = Lens(station.rig.cameras[name], camera_optics, settings.oversample)
        seeds = np.random.default_rng([seed, crc32(name.encode())])
        view = ViewRenderer(mi, station.cam_from_world(name), seeds)
        index, count = share
        pinholes = lens.make_pinholes(settings.passes * count)[index::count]
        if settings.bounces > 0:
            pictures = scene.render_paths(view, pinholes, settings.bounces)
        else:
            pictures = scene.render_direct(
                view, pinholes, lens.make_coarse_pinhole(), settings.ambient_samples
            )
        images[name] = lens.integrate_pixels(pinholes, pictures)
    return images
