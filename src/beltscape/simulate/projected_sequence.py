"""Pictures projected one after another, and the images of a monochrome core camera under each.

Fringes are the patterns of a structured-light projector: sinusoids, each shifted in equal steps.

Phase shifting: N pictures 1/2 + 1/2·cos(φ − 2πk/N), k = 0 … N − 1, of each number of fringes; several numbers of
fringes resolve the order of the fringe (Zuo et al., Optics and Lasers in Engineering 109, 2018, 23-59,
doi:10.1016/j.optlaseng.2018.04.019, and 85, 2016, 84-103, doi:10.1016/j.optlaseng.2016.04.022).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from beltscape.core.errors import InputError
from beltscape.simulate.rendering.render import RenderSettings, render, shift_labelled
from beltscape.simulate.rendering.sensor import Sensor, expose
from beltscape.simulate.scene_assembly import EXPOSURE_QUANTILE, EXPOSURE_SHARE, SimulatedScene
from beltscape.simulate.world import Label, Projector, Solid, World

_CHANNELS = 3
"""Colours of the renderer; each carries another picture."""


def render_sequence(
    scene: SimulatedScene,
    projector: Projector,
    pictures: NDArray[np.float32],
    *,
    travel_mm: float = 0.0,
    settings: RenderSettings | None = None,
    seed: int = 0,
) -> NDArray[np.uint8]:
    """Return the core camera's images of a scene under each of several pictures.

    Surfaces are grey to this camera, so that three pictures are rendered at once, in the renderer's three
    colours, as long as nothing moves. All images share one exposure, at which the brightest is just not
    saturated, and one seed: the noise of the rendered ambient light is the same in all of them and cancels
    between them.

    Parameters
    ----------
    scene
        The scene; its first frame is rendered.
    projector
        The projector; its own pattern is not used.
    pictures
        (F, h, w) linear light 0..1, before the projector's lens.
    travel_mm
        Travel of material and module along the belt from picture to picture; in the middle of the sequence they
        are at their positions in the scene.
    settings
        The sampling of the rendering; the scene's by default.
    seed
        Of light paths and noise.

    Returns
    -------
    images
        (F, H, W) uint8, the recorded images.

    Raises
    ------
    InputError
        If the pictures do not have the projector's size.
    """
    width, height = projector.camera.size_px
    if pictures.shape[1:] != (height, width):
        raise InputError(
            f"pictures are {pictures.shape[1:]}, the projector has {height} rows, {width} columns"
        )
    render_light = _render_moving if travel_mm else _render_still
    world = _remove_colour(scene.world_at(0))
    blur = scene.scenario.projector.blur_px
    irradiance = render_light(scene, world, projector, _blur(pictures, blur), travel_mm, settings, seed)
    sensor = _set_exposure(scene.scenario.sensor, irradiance)
    # separate noise for each image, as for the channels of a colour sensor
    images = [expose(image[..., None], sensor, [seed, k])[..., 0] for k, image in enumerate(irradiance)]
    return np.stack(images).astype(np.uint8)


def _render_still(
    scene: SimulatedScene,
    world: World,
    projector: Projector,
    pictures: Sequence[NDArray[np.float32]],
    travel_mm: float,
    settings: RenderSettings | None,
    seed: int,
) -> NDArray[np.float32]:
    """Return (F, H, W) light, three pictures at a time."""
    del travel_mm
    images: list[NDArray[np.float32]] = []
    for first in range(0, len(pictures), _CHANNELS):
        group = pictures[first : first + _CHANNELS]
        padded = [*group, *[group[-1]] * (_CHANNELS - len(group))]
        light = _render_pattern(scene, world, projector, np.stack(padded, axis=-1), settings, seed)
        images += [light[..., k] for k in range(len(group))]
    return np.stack(images)


def _render_moving(
    scene: SimulatedScene,
    world: World,
    projector: Projector,
    pictures: Sequence[NDArray[np.float32]],
    travel_mm: float,
    settings: RenderSettings | None,
    seed: int,
) -> NDArray[np.float32]:
    """Return (F, H, W) light, the load at another position for each picture."""
    moving_labels = {solid.label for solid in world.solids} - {Label.BELT, Label.FLOOR}
    middle = (len(pictures) - 1) / 2
    return np.stack(
        [
            _render_pattern(
                scene,
                shift_labelled(world, (k - middle) * travel_mm, moving_labels),
                projector,
                np.repeat(picture[..., None], _CHANNELS, axis=-1),
                settings,
                seed,
            )[..., 0]
            for k, picture in enumerate(pictures)
        ]
    )


def _render_pattern(
    scene: SimulatedScene,
    world: World,
    projector: Projector,
    pattern: NDArray[np.float32],
    settings: RenderSettings | None,
    seed: int,
) -> NDArray[np.float32]:
    """Return (H, W, 3) light on the core camera under a pattern (h, w, 3)."""
    core = scene.station.rig.core
    lit_world = replace(world, projector=replace(projector, pattern=np.ascontiguousarray(pattern)))
    sampling = settings or scene.scenario.render
    return render(lit_world, scene.station, {core: scene.scenario.optics}, sampling, seed=seed)[core]


def _blur(pictures: NDArray[np.float32], sigma_px: float) -> list[NDArray[np.float32]]:
    """Return the pictures behind the projector's lens."""
    if sigma_px == 0:
        return list(pictures)
    border = cv2.BORDER_CONSTANT
    return [
        np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma_px, borderType=border)) for picture in pictures
    ]


def _remove_colour(world: World) -> World:
    """Return the world of a monochrome camera under white light: each surface has the mean of its colours."""
    return replace(world, solids=tuple(_average_channels(solid) for solid in world.solids))


def _average_channels(solid: Solid) -> Solid:
    if solid.texture is None:
        return replace(solid, reflectance=(float(np.mean(solid.reflectance)),) * 3)
    mean = (solid.texture * np.array(solid.reflectance, np.float32)).mean(axis=-1, keepdims=True)
    return replace(solid, reflectance=(1.0, 1.0, 1.0), texture=np.repeat(mean, 3, axis=-1))


def _set_exposure(sensor: Sensor, irradiance: NDArray[np.float32]) -> Sensor:
    """Return the sensor, monochrome, exposed for the brightest of the images."""
    bright = max(float(np.quantile(irradiance.max(axis=0), EXPOSURE_QUANTILE)), 1e-6)
    electrons = EXPOSURE_SHARE * sensor.full_well_e / bright / sensor.gain
    return sensor.model_copy(update={"colour": "rgb", "bits": 8, "electrons_at_1": electrons})


class FringeSettings(BaseModel):
    """A sequence of fringe patterns across the projector's columns."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    fringes: Annotated[
        tuple[Annotated[float, Field(ge=0.5, le=2000)], ...], Field(min_length=1, max_length=8)
    ] = (
        1.0,
        8.0,
        64.0,
    )
    """Numbers of fringes over the projector's width, coarse first; the first, 1 or less, is unambiguous."""
    steps: Annotated[int, Field(ge=3, le=64)] = 4
    """Phase shifts per number of fringes."""

    @model_validator(mode="after")
    def _check_order(self) -> FringeSettings:
        if list(self.fringes) != sorted(set(self.fringes)) or self.fringes[0] > 1:
            raise ValueError(f"fringes = {list(self.fringes)}: ascending, and the first not above 1")
        return self

    @property
    def frames(self) -> int:
        """Return the number of pictures of the whole sequence."""
        return len(self.fringes) * self.steps

    def periods_px(self, width_px: int) -> tuple[float, ...]:
        """Return the period of the fringes on a projector of this width, by number of fringes."""
        return tuple(width_px / count for count in self.fringes)


def make_fringe_patterns(settings: FringeSettings, size_px: tuple[int, int]) -> NDArray[np.float32]:
    """Return (F, H, W) linear light 0..1 of a projector (W, H): all shifts of one fringe number, then the next."""
    width, height = size_px
    columns = np.arange(width)
    rows = [
        0.5 + 0.5 * np.cos(2 * np.pi * (columns / period - k / settings.steps))
        for period in settings.periods_px(width)
        for k in range(settings.steps)
    ]
    return np.repeat(np.array(rows, np.float32)[:, None], height, axis=1)
