"""Pictures projected one after the other, and what a monochrome core camera sees of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import InputError
from beltscape.simulate.geometry.world import Label, Projector, Solid, World
from beltscape.simulate.rendering.motion_blur import shift_labelled
from beltscape.simulate.rendering.render import RenderSettings, render
from beltscape.simulate.rendering.sensor import Sensor, expose
from beltscape.simulate.scene_assembly import EXPOSURE_QUANTILE, EXPOSURE_SHARE, SimulatedScene

_CHANNELS = 3
"""The renderer's colours, each of which carries another picture."""


def render_sequence(
    scene: SimulatedScene,
    projector: Projector,
    pictures: NDArray[np.float32],
    *,
    travel_mm: float = 0.0,
    settings: RenderSettings | None = None,
    seed: int = 0,
) -> NDArray[np.uint8]:
    """The core camera's images of a scene under each of several pictures.

    Surfaces are grey to this camera, so that three pictures are rendered at once, in the renderer's three colours,
    as long as nothing moves. All share one exposure, such that the brightest just fits, and one seed: the little
    noise in the rendered light of the hall is the same in all of them, and so is none between them.

    Parameters
    ----------
    scene
        The scene; its first frame.
    projector
        Who projects; its own pattern is not used.
    pictures
        (F, h, w) linear light 0..1, before the projector's lens.
    travel_mm
        How far material and module travel along the belt from picture to picture; the middle of the sequence is where
        they stand in the scene.
    settings
        How carefully is rendered; the scene's by default.
    seed
        Of light paths and noise.

    Returns
    -------
    images
        (F, H, W) uint8, as the camera takes them.

    Raises
    ------
    InputError
        When the pictures do not have the projector's size.
    """
    width, height = projector.camera.size_px
    if pictures.shape[1:] != (height, width):
        raise InputError(
            f"pictures are {pictures.shape[1:]}, the projector has {height} rows, {width} columns"
        )
    render_light = _render_moving if travel_mm else _render_still
    world = _remove_colour(scene.world_at(0))
    blur = scene.scenario.projector.blur_px
    seen = render_light(scene, world, projector, _blur(pictures, blur), travel_mm, settings, seed)
    sensor = _set_exposure(scene.scenario.sensor, seen)
    # one noise for each image: as a sensor of three colours whose colours are images of their own
    images = [expose(image[..., None], sensor, [seed, k])[..., 0] for k, image in enumerate(seen)]
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
    """(F, H, W) light, three pictures at a time."""
    del travel_mm
    seen: list[NDArray[np.float32]] = []
    for first in range(0, len(pictures), _CHANNELS):
        group = pictures[first : first + _CHANNELS]
        padded = [*group, *[group[-1]] * (_CHANNELS - len(group))]
        light = _render_pattern(scene, world, projector, np.stack(padded, axis=-1), settings, seed)
        seen += [light[..., k] for k in range(len(group))]
    return np.stack(seen)


def _render_moving(
    scene: SimulatedScene,
    world: World,
    projector: Projector,
    pictures: Sequence[NDArray[np.float32]],
    travel_mm: float,
    settings: RenderSettings | None,
    seed: int,
) -> NDArray[np.float32]:
    """(F, H, W) light, the load at another place for each picture."""
    carried = {solid.label for solid in world.solids} - {Label.BELT, Label.FLOOR}
    middle = (len(pictures) - 1) / 2
    return np.stack(
        [
            _render_pattern(
                scene,
                shift_labelled(world, (k - middle) * travel_mm, carried),
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
    """(H, W, 3) light on the core camera under a pattern (h, w, 3)."""
    core = scene.station.rig.core
    lit = replace(world, projector=replace(projector, pattern=np.ascontiguousarray(pattern)))
    how = settings or scene.scenario.render
    return render(lit, scene.station, {core: scene.scenario.optics}, how, seed=seed)[core]


def _blur(pictures: NDArray[np.float32], sigma_px: float) -> list[NDArray[np.float32]]:
    """Each as the projector's lens lets it out."""
    if sigma_px == 0:
        return list(pictures)
    border = cv2.BORDER_CONSTANT
    return [np.asarray(cv2.GaussianBlur(one, (0, 0), sigma_px, borderType=border)) for one in pictures]


def _remove_colour(world: World) -> World:
    """The world as a monochrome camera under white light has it: each surface of the mean of its colours."""
    return replace(world, solids=tuple(_average_channels(solid) for solid in world.solids))


def _average_channels(solid: Solid) -> Solid:
    if solid.texture is None:
        return replace(solid, reflectance=(float(np.mean(solid.reflectance)),) * 3)
    mean = (solid.texture * np.float32(solid.reflectance)).mean(axis=-1, keepdims=True)
    return replace(solid, reflectance=(1.0, 1.0, 1.0), texture=np.repeat(mean, 3, axis=-1))


def _set_exposure(sensor: Sensor, seen: NDArray[np.float32]) -> Sensor:
    """The sensor, monochrome, exposed for the brightest of the images."""
    full = max(float(np.quantile(seen.max(axis=0), EXPOSURE_QUANTILE)), 1e-6)
    electrons = EXPOSURE_SHARE * sensor.full_well_e / full / sensor.gain
    return sensor.model_copy(update={"colour": "rgb", "bits": 8, "electrons_at_1": electrons})
