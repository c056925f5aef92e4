"""The cameras and the projector of a scenario at their poses above the belt.

The poses of a calibration board lie in front of the cameras.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Array
from beltscape.core.errors import InputError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.lens import MODELS
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig, scale_camera
from beltscape.files.rig_json import read_rig
from beltscape.simulate.grains import GRAIN_PATTERNS
from beltscape.simulate.scenario import BoardSpec, ProjectorSpec, RigSpec
from beltscape.simulate.world import Projector, Station
from beltscape.target.board import Board, corner_points_mm
from beltscape.target.pattern import PRESETS, Pattern, PatternSettings, make_pattern
from beltscape.target.pattern_formats import draw_pattern, read_pattern

DOWN = np.diag([1.0, -1.0, -1.0])
"""Rotation of a camera that looks vertically down, its rows across the belt."""
FOCAL_SCATTER, CENTER_SCATTER, POSITION_SCATTER_MM, ROTATION_SCATTER = 0.004, 0.01, 5.0, np.deg2rad(0.7)
"""Standard deviations at a scatter of 1."""
DISTORTION_SCATTER = {"k1": 0.01, "k2": 0.015, "p1": 4e-4, "p2": 4e-4}
"""Standard deviations of coefficients from lens to lens, 0 for all others; assumed."""


def make_station(spec: RigSpec) -> Station:
    """Return the true rig and its pose.

    Raises
    ------
    InputError
        If ``spec.file`` cannot be read.
    """
    turn = Pose.of([0.0, 0.0, -np.deg2rad(spec.yaw_deg)], np.zeros(3))
    core_from_world = Pose(DOWN.copy(), DOWN @ np.array([0.0, 0.0, -spec.height_mm])) @ turn
    if spec.file is not None:
        rig = read_rig(spec.file)
        cameras = {name: scale_camera(camera, spec.image_scale) for name, camera in rig.cameras.items()}
        return Station(Rig(rig.core, cameras, rig.cam_from_core), core_from_world)
    rng = np.random.default_rng([spec.seed, 1])
    count = spec.auxiliaries + 1
    cameras = {f"cam{i}": _make_camera(f"cam{i}", spec, rng) for i in range(count)}
    ahead = (spec.height_mm - spec.aim_mm) * float(np.tan(np.deg2rad(spec.tilt_deg)))
    targets = [np.array([0.0, along, spec.aim_mm]) for along in (ahead, *[0.0] * spec.auxiliaries)]
    from_world = [
        _perturb(_aim(position, target), spec.scatter, rng) @ turn
        for position, target in zip(_camera_positions(spec), targets, strict=True)
    ]
    core_from_world = from_world[0]
    poses = {f"cam{i}": pose @ core_from_world.inverse() for i, pose in enumerate(from_world)}
    poses["cam0"] = Pose.identity()
    return Station(Rig("cam0", cameras, poses), core_from_world)


def make_projector(spec: ProjectorSpec) -> Projector:
    """Return the projector with its pattern.

    Raises
    ------
    InputError, SettingsError
        If the pattern cannot be read or generated.
    """
    light = _draw_light(spec)
    height, width = light.shape[:2]
    position = np.array(spec.position_mm)
    focal = width * float(np.linalg.norm(position)) / spec.covers_mm
    lens = Camera(
        "projector", (width, height), np.full(2, focal), (np.array([width, height]) - 1) / 2, np.zeros(5)
    )
    if spec.blur_px > 0:
        light = cv2.GaussianBlur(light, (0, 0), spec.blur_px, borderType=cv2.BORDER_CONSTANT)
    return Projector(lens, _aim(position, np.zeros(3)), light.astype(np.float32), spec.power)


def _draw_light(spec: ProjectorSpec) -> NDArray[np.float32]:
    """Return the light (H, W, 3) of the pattern before the lens, 0 to 1."""
    if str(spec.pattern) in GRAIN_PATTERNS:
        lit = GRAIN_PATTERNS[str(spec.pattern)](spec.size_px, spec.cell_px, spec.seed)
        return np.repeat(lit.astype(np.float32)[..., None], 3, axis=2)
    pixels = draw_pattern(_load_pattern(spec), 16)
    return ((pixels / np.float32(65535)) ** np.float32(spec.gamma)).astype(np.float32)


def _load_pattern(spec: ProjectorSpec) -> Pattern:
    if str(spec.pattern) in PRESETS:
        return _make_preset(spec.size_px, spec.seed, PRESETS[str(spec.pattern)])
    pattern = read_pattern(Path(spec.pattern))
    if pattern.size_px != spec.size_px:
        raise InputError(
            f"{spec.pattern}: the pattern has {pattern.size_px[0]}×{pattern.size_px[1]} px, the projector "
            f"{spec.size_px[0]}×{spec.size_px[1]}; set projector.size_px"
        )
    return pattern


@lru_cache(maxsize=4)
def _make_preset(size_px: tuple[int, int], seed: int, count: int) -> Pattern:
    """Return a generated pattern, which scenes of the same projector share: throwing its dots takes half a second."""
    return make_pattern(PatternSettings(size_px=size_px, seed=seed, count=count))


def _make_camera(name: str, spec: RigSpec, rng: np.random.Generator) -> Camera:
    size = np.array(spec.size_px)
    focal_x = 1000 * spec.focal_mm / spec.pitch_um * (1 + spec.scatter * FOCAL_SCATTER * rng.normal())
    focal = focal_x * np.array(
        [1.0, 1 + spec.scatter * FOCAL_SCATTER / 10 * rng.normal()]
    )  # pixels are nearly square
    center = (size - 1) / 2 + spec.scatter * CENTER_SCATTER * size[0] * rng.normal(size=2)
    deviations = np.array([DISTORTION_SCATTER.get(each, 0.0) for each in MODELS[spec.model].coefficients])
    distortion = np.array(spec.distortion) + spec.scatter * deviations * rng.normal(size=len(deviations))
    camera = Camera(name, spec.size_px, focal, center, distortion, spec.model)
    return scale_camera(camera, spec.image_scale)


def _camera_positions(spec: RigSpec) -> list[Array]:
    """Return (3,) positions of the cameras, the core first, of a rig that is not turned."""
    angles = np.deg2rad(spec.first_deg + spec.around_deg * np.arange(spec.auxiliaries) / spec.auxiliaries)
    baselines = spec.baselines_mm or (spec.baseline_mm,) * spec.auxiliaries
    offsets = [b * np.array([np.cos(a), np.sin(a), 0.0]) for a, b in zip(angles, baselines, strict=True)]
    return [np.array([0.0, 0.0, spec.height_mm]) + offset for offset in (np.zeros(3), *offsets)]


def _aim(position: Array, target: Array) -> Pose:
    """Return cam_from_world of a camera that looks vertically down, rotated by the shortest way towards a point."""
    down, direction = np.array([0.0, 0.0, -1.0]), (target - position) / np.linalg.norm(target - position)
    axis = np.cross(down, direction)
    sine = float(np.linalg.norm(axis))
    rotation_vector = axis / sine * np.arctan2(sine, float(down @ direction)) if sine > 0 else axis
    rotation = DOWN @ Pose.of(rotation_vector, np.zeros(3)).rotation.T
    return Pose(rotation, -rotation @ position)


def _perturb(pose: Pose, scatter: float, rng: np.random.Generator) -> Pose:
    """Return the pose with random errors of mounting."""
    rotation = Pose.of(scatter * ROTATION_SCATTER * rng.normal(size=3), np.zeros(3)).rotation
    center = pose.center_mm + scatter * POSITION_SCATTER_MM * rng.normal(size=3)
    return Pose(rotation @ pose.rotation, -rotation @ pose.rotation @ center)


def sample_board_poses(
    spec: BoardSpec, board: Board, station: Station, count: int, seed: int
) -> tuple[Pose, ...]:
    """Return world_from_board of ``count`` poses, spread over the core's view, over depths and over tilts.

    Positions and depths follow a Halton-like sequence, tilts the golden angle: few frames are spread as well as many.
    """
    rng = np.random.default_rng([seed, 3])
    corners = corner_points_mm(board)
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    camera = station.rig.core_camera
    start = rng.random(3)
    poses: list[Pose] = []
    for i in range(count):
        u, v, w = (start + i * np.array([0.7548776662, 0.5698402910, 0.6180339887])) % 1.0
        depth = spec.depth_mm[0] + w * (spec.depth_mm[1] - spec.depth_mm[0])
        pixel = (np.array([u, v]) - 0.5) * spec.reach * np.array(camera.size_px)
        center, facing = _place_middle(camera, pixel, depth, spec.faces_core)
        azimuth, angle = 2.399963 * i, np.deg2rad(spec.tilt_deg) * np.sqrt((i % 5 + rng.random()) / 5)
        tilt = Pose.of([angle * np.cos(azimuth), angle * np.sin(azimuth), 0.0], np.zeros(3))
        roll = Pose.of([0.0, 0.0, rng.uniform(-0.6, 0.6) + np.pi / 2 * (i % 4 == 3)], np.zeros(3))
        rotation = facing @ tilt.rotation @ roll.rotation
        core_from_board = Pose.placing(rotation, middle, center)
        poses.append(station.core_from_world.inverse() @ core_from_board)
    return tuple(poses)


def _place_middle(camera: Camera, pixel: Array, depth_mm: float, faces_camera: bool) -> tuple[Array, Array]:
    """Return the board's middle (3,) at a place of the image, px from its centre, and the turn (3, 3) towards it."""
    if not faces_camera:
        return np.append(pixel / camera.focal_px, 1.0) * depth_mm, np.eye(3)
    ray = np.append(camera.undistort(camera.center_px + pixel), 1.0)
    ray /= np.linalg.norm(ray)
    across = np.cross([0.0, 1.0, 0.0], ray)
    across /= np.linalg.norm(across)
    return depth_mm * ray, np.column_stack([across, np.cross(ray, across), ray])
