"""A foreign object drawn into images that another program rendered.

Rays decide what each pixel sees of the object and where the projector lights it, so that its dots agree in all
cameras. Not drawn: its shadow on the belt.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy import ndimage

from beltscape.core.frames import Image, to_grey
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.files.images import read_image
from beltscape.files.json_text import read_json
from beltscape.simulate.faults.belt import ForeignObject
from beltscape.simulate.ray_casting import RayScene
from beltscape.simulate.world import Solid

_SAMPLES = 4
"""Rays across and along a pixel."""
_LIT = 90.0
"""Grey value of a fully lit surface at the belt's distance: that of the lightest stones of the moving belt."""
_UNLIT = 4.0
"""Grey value without the projector, as on its belt."""
_BLUR_PX = 0.3
"""Point spread of images of this size, from the description of the captures."""
_NOISE = 0.75
"""Noise of images that are averages of 2 × 2 pixels, grey values."""


@dataclass(frozen=True)
class Projector:
    """A projector without distortion."""

    matrix: np.ndarray
    from_world: Pose
    pattern: np.ndarray
    """(H, W) linear light, 0 to 1."""

    def light(self, points_mm: np.ndarray) -> np.ndarray:
        """Return the light (N,) on points (N, 3) of the world that face it, 1 at the belt's distance."""
        local = self.from_world.apply(points_mm)
        pixels = (local / local[:, 2:]) @ self.matrix.T
        seen = ndimage.map_coordinates(self.pattern, pixels[:, 1::-1].T, order=1, cval=0.0)
        return seen * (self.from_world.translation_mm[2] / local[:, 2]) ** 2


def read_projector(rendered: Path) -> Projector:
    """Return the projector of a folder of rendered captures."""
    truth = read_json(rendered / "truth" / "projector.json")
    picture = to_grey(read_image(rendered / "pattern" / "speckle_1920x1200.png"))
    linear = (picture / picture.max()) ** 2.2
    return Projector(np.array(truth["K"]), Pose.of(truth["R"], truth["t"]), linear)


def draw_objects(
    images: Mapping[str, Image],
    rig: Rig,
    core_from_world: Pose,
    projector: Projector,
    objects: Sequence[ForeignObject],
    frame: int,
) -> dict[str, Image]:
    """Return the images (H, W) with what is there of the objects in a frame."""
    solids = [solid for each in objects if (solid := each.make_solid(frame)) is not None]
    if not solids:
        return dict(images)
    scene, rng = RayScene(solids), np.random.default_rng([frame, 17])
    drawn: dict[str, Image] = {}
    for name, camera in rig.cameras.items():
        camera_from_world = rig.cam_from_core[name] @ core_from_world
        drawn[name] = _draw(images[name], camera, camera_from_world, projector, scene, solids, rng)
    return drawn


def _draw(
    image: Image,
    camera: Camera,
    camera_from_world: Pose,
    projector: Projector,
    scene: RayScene,
    solids: Sequence[Solid],
    rng: np.random.Generator,
) -> Image:
    corners = np.concatenate([solid.vertices_mm for solid in solids])
    around = camera.project(camera_from_world.apply(corners))
    low = np.maximum(np.floor(np.nanmin(around, axis=0)).astype(int) - 3, 0)
    high = np.minimum(np.ceil(np.nanmax(around, axis=0)).astype(int) + 4, np.array(camera.size_px))
    if (high <= low).any():
        return image
    columns, rows = (
        start + (np.arange(_SAMPLES * (end - start)) + 0.5) / _SAMPLES - 0.5
        for start, end in zip(low, high, strict=True)
    )
    ideal = camera.undistort(np.stack(np.meshgrid(columns, rows), axis=-1)).reshape(-1, 2)
    directions = np.column_stack([ideal, np.ones(len(ideal))]) @ camera_from_world.rotation
    center = camera_from_world.inverse().translation_mm
    hits = scene.cast(center, directions)
    is_hit = hits.face >= 0
    light = np.zeros(len(directions), np.float32)
    light[is_hit] = _shade(
        center + hits.distance[is_hit, None] * directions[is_hit], scene, hits.face[is_hit], projector
    )
    shape = (len(rows), len(columns))
    share, level = (_average(values.reshape(shape)) for values in (is_hit.astype(np.float32), light))
    part = image[low[1] : high[1], low[0] : high[0]]
    noise = _NOISE * rng.standard_normal(part.shape, dtype=np.float32) * (share > 0)
    result = image.copy()
    result[low[1] : high[1], low[0] : high[0]] = np.clip(
        np.rint((1 - share) * part + level + noise), 0, 255
    ).astype(image.dtype)
    return result


def _shade(points_mm: np.ndarray, scene: RayScene, faces: np.ndarray, projector: Projector) -> np.ndarray:
    """Return the grey values (N,) of points on faces of the objects."""
    a, b, c = np.moveaxis(scene.corners_mm[faces], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    source = projector.from_world.inverse().translation_mm
    rays = source - points_mm
    cosine = np.einsum("ni,ni->n", normals, rays) / np.linalg.norm(rays, axis=1)
    is_free = scene.is_free(points_mm + 0.01 * normals, source)
    return (_UNLIT + _LIT * projector.light(points_mm) * np.maximum(cosine, 0.0) * is_free).astype(np.float32)


def _average(values: np.ndarray) -> np.ndarray:
    """Return the blurred means of the samples of each pixel."""
    height, width = (extent // _SAMPLES for extent in values.shape)
    means = values.reshape(height, _SAMPLES, width, _SAMPLES).mean(axis=(1, 3))
    return cv2.GaussianBlur(means, (0, 0), _BLUR_PX)
