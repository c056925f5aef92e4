"""Rendering of a world for its cameras: the light on every pixel, before any sensor.

Of Mitsuba's engines, `scalar` is always available; `llvm` compiles the scene and needs LLVM 19 or later. The image
of a moving belt is averaged over the world at the instants of an exposure.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from math import ceil
from typing import Annotated, Any, Literal, cast
from zlib import crc32

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.errors import InputError, SettingsError
from beltscape.simulate.rendering.lit_scene import LitScene, ViewRenderer
from beltscape.simulate.rendering.optics import Lens, Optics
from beltscape.simulate.world import Label, Station, World

Engine = Literal["scalar", "llvm", "auto"]
_VARIANTS = {"scalar": "scalar_rgb", "llvm": "llvm_ad_rgb"}
_OLDEST_LLVM = 19
"""LLVM 15 aborts the process during a compilation ("Cannot select fminimum"); 19 renders the tests' scenes."""


def load_mitsuba(engine: Engine) -> Any:
    """Return Mitsuba with its variant set.

    Raises
    ------
    SettingsError
        If `llvm` is requested and LLVM is not installed.
    """
    import mitsuba as mi

    mi.set_variant(_VARIANTS[resolve_engine(engine)])
    return mi


def resolve_engine(engine: Engine) -> Literal["scalar", "llvm"]:
    """Return the engine that renders; ``auto`` is `llvm` where LLVM is installed, else `scalar`.

    Raises
    ------
    SettingsError
        If `llvm` is requested and LLVM is not installed.
    """
    if engine == "scalar":
        return "scalar"
    version = _llvm_version()
    if engine == "llvm" and version < _OLDEST_LLVM:
        installed = f"finds LLVM {version}" if version >= 0 else "finds none"
        raise SettingsError(
            f"the engine llvm needs LLVM's shared library, version {_OLDEST_LLVM} or later, and {installed}; "
            "install it, set DRJIT_LIBLLVM_PATH, or choose scalar"
        )
    return "llvm" if version >= _OLDEST_LLVM else "scalar"


def _llvm_version() -> int:
    """Return the major version of the LLVM that Dr.Jit finds, -1 where it finds none."""
    import drjit

    previous_level = drjit.log_level()
    drjit.set_log_level(drjit.LogLevel.Disable)  # a missing LLVM is no error here
    try:
        return int(
            cast(Any, drjit.detail).llvm_version()[0]
        )  # drjit does not say what the version is made of
    finally:
        drjit.set_log_level(previous_level)


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
