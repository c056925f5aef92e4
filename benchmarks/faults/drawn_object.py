"""A foreign object drawn into images that another program rendered.

Rays decide what each pixel sees of the object and where the projector lights it, so that its dots agree in all
cameras. Not drawn: its shadow on the belt.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from scipy import ndimage

from beltscape.core.frames import Image, to_grey
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.files.images import read_image
from beltscape.files.json_text import read_json
from beltscape.simulate.faults.belt import ForeignObject
from beltscape.simulate.ray_casting import RayScene
from beltscape.simulate.world import Projector, Solid, Station
from captures import parse_true_camera

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


def read_projector(rendered: Path) -> Projector:
    """Return the projector of a folder of rendered captures."""
    truth = read_json(rendered / "truth" / "projector.json")
    picture = to_grey(read_image(rendered / "pattern" / "speckle_1920x1200.png"))
    light = np.repeat(((picture / picture.max()) ** 2.2)[..., None], 3, axis=2)
    lens = parse_true_camera("projector", truth, truth["size"])
    return Projector(lens, Pose.of(truth["R"], truth["t"]), light, power=1.0)


def draw_objects(
    images: Mapping[str, Image],
    station: Station,
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
    for name, camera in station.rig.cameras.items():
        pose = station.cam_from_world(name)
        drawn[name] = _draw(images[name], camera, pose, projector, scene, solids, rng)
    return drawn


def _draw(
    image: Image,
    camera: Camera,
    cam_from_world: Pose,
    projector: Projector,
    scene: RayScene,
    solids: Sequence[Solid],
    rng: np.random.Generator,
) -> Image:
    corners = np.concatenate([solid.vertices_mm for solid in solids])
    around = camera.project(cam_from_world.apply(corners))
    low = np.maximum(np.floor(np.nanmin(around, axis=0)).astype(int) - 3, 0)
    high = np.minimum(np.ceil(np.nanmax(around, axis=0)).astype(int) + 4, np.array(camera.size_px))
    if (high <= low).any():
        return image
    columns, rows = (
        start + (np.arange(_SAMPLES * (end - start)) + 0.5) / _SAMPLES - 0.5
        for start, end in zip(low, high, strict=True)
    )
    ideal = camera.undistort(np.stack(np.meshgrid(columns, rows), axis=-1)).reshape(-1, 2)
    directions = np.column_stack([ideal, np.ones(len(ideal))]) @ cam_from_world.rotation
    center = cam_from_world.center_mm
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
    pose, normals = projector.projector_from_world, scene.face_normals(faces)
    rays = pose.center_mm - points_mm
    cosine = np.einsum("ni,ni->n", normals, rays) / np.linalg.norm(rays, axis=1)
    seen = scene.is_visible_from(points_mm, normals, pose.center_mm)
    local = pose.apply(points_mm)
    at = projector.camera.project(local)[:, ::-1].T
    pattern = ndimage.map_coordinates(projector.pattern[..., 0], at, order=1, cval=0.0)
    falloff = (pose.translation_mm[2] / local[:, 2]) ** 2
    return (_UNLIT + _LIT * pattern * falloff * np.where(seen, cosine, 0.0)).astype(np.float32)


def _average(values: np.ndarray) -> np.ndarray:
    """Return the blurred means of the samples of each pixel."""
    height, width = (extent // _SAMPLES for extent in values.shape)
    means = values.reshape(height, _SAMPLES, width, _SAMPLES).mean(axis=(1, 3))
    return cv2.GaussianBlur(means, (0, 0), _BLUR_PX)
