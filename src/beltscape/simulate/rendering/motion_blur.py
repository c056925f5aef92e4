"""A moving belt: the world at the instants of an exposure, and the image averaged over them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from math import ceil

import numpy as np
from numpy.typing import NDArray

from beltscape.simulate.geometry.world import Label, Station, World
from beltscape.simulate.rendering.optics import Optics
from beltscape.simulate.rendering.render import RenderSettings, render

_STEP_PX = 0.3
"""Largest motion from instant to instant, px."""


def shift_labelled(world: World, along_mm: float, labels: Collection[int] = (Label.MATERIAL,)) -> World:
    """Return the world with its solids of these labels shifted along the belt; the projector stays."""
    carried = tuple(solid.shift(along_mm) if solid.label in labels else solid for solid in world.solids)
    return replace(world, solids=carried)


def sample_exposure(
    world: World, station: Station, travel_mm: float, labels: Collection[int] = (Label.MATERIAL,)
) -> list[World]:
    """Return the world at the instants of an exposure, as many as keep each step on the belt below 0.3 px.

    ``world`` is the middle of the exposure, in which the belt travels ``travel_mm``.
    """
    px_per_mm = max(
        float(camera.focal_px.max() / station.cam_from_world(name).translation_mm[2])
        for name, camera in station.rig.cameras.items()
    )
    count = max(1, int(np.ceil(abs(travel_mm) * px_per_mm / _STEP_PX)))
    return [shift_labelled(world, travel_mm * ((k + 0.5) / count - 0.5), labels) for k in range(count)]


def render_exposure(
    worlds: Sequence[World],
    station: Station,
    optics: Mapping[str, Optics],
    settings: RenderSettings | None = None,
    *,
    seed: int = 0,
) -> dict[str, NDArray[np.float32]]:
    """Return the mean light of several instants, in the form of `render`.

    The settings' samples are divided among the instants, so that an exposure needs hardly more light paths than a
    still image.
    """
    settings = settings or RenderSettings()
    shared = _split_samples(settings, len(worlds))
    total: dict[str, NDArray[np.float32]] = {}
    for index, world in enumerate(worlds):
        share = (index, len(worlds))
        images = render(world, station, optics, shared, seed=seed * len(worlds) + index, share=share)
        for name, image in images.items():
            total[name] = total[name] + image if name in total else image
    return {name: image / np.float32(len(worlds)) for name, image in total.items()}


def _split_samples(settings: RenderSettings, count: int) -> RenderSettings:
    """Return the settings of each of ``count`` instants, which together have the settings' samples."""
    samples = settings.passes * settings.oversample**2 / count
    oversample = settings.oversample if samples >= settings.oversample**2 else 1
    return settings.model_copy(
        update={
            "oversample": oversample,
            "passes": ceil(samples / oversample**2),
            "ambient_samples": ceil(settings.ambient_samples / count),
        }
    )
