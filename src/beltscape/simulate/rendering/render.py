"""A world as its cameras see it: the light on every pixel, before any sensor."""

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
    """How carefully is rendered."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    oversample: Annotated[int, Field(ge=1, le=8)] = 2
    """Sub-samples per pixel, in each direction."""
    passes: Annotated[int, Field(ge=1, le=256)] = 3
    """Interleaved sets of such sub-samples; Fibonacci numbers (2, 3, 5, 8, 13) interleave best."""
    ambient_samples: Annotated[int, Field(ge=1, le=256)] = 4
    """Rays per pixel that find out how much of the hall's light arrives; rounded up to a square."""
    bounces: Annotated[int, Field(ge=0, le=8)] = 0
    """How often light may go from surface to surface before it reaches a camera: 0 is direct light only, without
    noise in the projector's light; more is sampled at random and wants many passes."""
    texture_filter: Literal["nearest", "bilinear"] = "nearest"
    """Of solids' textures: sharp texels, or blended ones."""
    engine: Engine = "scalar"
    """The same scene gives the same bytes on every machine by one engine; `auto` takes what a machine has."""


def render(
    world: World,
    station: Station,
    optics: Mapping[str, Optics],
    settings: RenderSettings | None = None,
    *,
    seed: int = 0,
    share: tuple[int, int] = (0, 1),
) -> dict[str, NDArray[np.float32]]:
    """Light per camera, (H, W, 3) float32 linear RGB; 1 is a white surface under ambient light of 1.

    Parameters
    ----------
    world
        What is seen, and the light.
    station
        The cameras.
    optics
        By camera name; a camera that is not named is not rendered.
    settings
        How carefully.
    seed
        Of the light paths: take another for every frame. The result is the same for any number of threads.

    share
        (index, count): of so many pictures that will be averaged this is that one, so that their sub-samples
        interleave.

    Raises
    ------
    InputError
        If a solid, the projector or a camera cannot be rendered.
    SettingsError
        If the engine is not there.
    """
    settings = settings or RenderSettings()
    for name in optics:
        if name not in station.rig.cameras:
            raise InputError(
                f"optics of {name}: the rig has no such camera; it has {', '.join(station.rig.cameras)}"
            )
    mi = load_mitsuba(settings.engine)
    scene = LitScene(mi, world, texture_filter=settings.texture_filter)
    images = {}
    for name, its_optics in optics.items():
        lens = Lens(station.rig.cameras[name], its_optics, settings.oversample)
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
