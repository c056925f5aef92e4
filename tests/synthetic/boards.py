"""Exactly rendered views of a printed board: a ray per sub-pixel through the true lens onto the true board."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.files.images import write_image
from beltscape.target.planar_boards import AprilGrid, CharucoBoard, PlanarBoard

SIZE_PX = (480, 400)
_CELL = 48
"""Texture pixels per square."""
_SUPER = 3
"""Rays per pixel edge."""


@dataclass(frozen=True)
class Print:
    """The print and the photograph of the board."""

    legacy: bool = False
    inverted: bool = False
    blur_px: float = 0.5
    noise: float = 1.0
    seed: int = 1


def facing(board: PlanarBoard, roll: float = 0.0, tilt: float = 0.3, distance_mm: float = 600.0) -> Pose:
    """Return cam_from_board with the board's middle on the optical axis."""
    columns, rows = board.grid
    middle = np.array([columns + 1, rows + 1, 0]) / 2 * board.square_mm
    turn = Pose.of([0, 0, roll], [0, 0, 0]) @ Pose.of([tilt, tilt / 2, 0], [0, 0, 0])
    return Pose(turn.rotation, np.array([0, 0, distance_mm]) - turn.rotation @ middle)


def camera(
    name: str, focal_px: float = 520.0, k1: float = -0.12, size_px: tuple[int, int] = SIZE_PX
) -> Camera:
    """Return a camera with visible distortion and a principal point off the centre."""
    width, height = size_px
    return Camera(
        name=name,
        size_px=size_px,
        focal_px=np.array([focal_px, focal_px * 1.003]),
        center_px=np.array([width / 2 + 4.2, height / 2 - 3.1]),
        distortion=np.array([k1, 0.06, 4e-4, -6e-4, 0.0]),
    )


def row_of_cameras(names: Sequence[str], step_mm: float = 120.0, distance_mm: float = 700.0) -> Rig:
    """Return cameras in a row, aimed at one point ``distance_mm`` in front of the first, which is the core."""
    cam_from_core: dict[str, Pose] = {}
    for i, name in enumerate(names):
        x = step_mm * i
        turn = Pose.of([0.0, np.arctan2(x, distance_mm), 0.0], np.zeros(3))
        tilt = Pose.of([0.03 * (-1) ** i, 0.0, 0.02 * i], np.zeros(3)) if i else Pose.identity()
        rotation = tilt.rotation @ turn.rotation
        cam_from_core[name] = Pose(rotation, -rotation @ np.array([x, 4.0 * i, -3.0 * i]))
    cameras = {name: camera(name, 520.0 + 6 * i, -0.12 + 0.02 * i) for i, name in enumerate(names)}
    return Rig(names[0], cameras, cam_from_core)


def board_poses(
    board: PlanarBoard,
    count: int,
    distance_mm: float = 700.0,
    tilt: float = 0.5,
    seed: int = 4,
    x_mm: float = 0.0,
) -> list[Pose]:
    """Return core_from_board of boards about the optical axis, tilted in all directions."""
    rng = np.random.default_rng(seed)
    columns, rows = board.grid
    middle = np.array([columns + 1, rows + 1, 0]) / 2 * board.square_mm
    poses = []
    for i in range(count):
        azimuth = 2.4 * i  # the golden angle spreads the directions evenly
        angle = tilt * (0.6 + 0.4 * rng.random())
        rotation = Pose.of(
            [angle * np.cos(azimuth), angle * np.sin(azimuth), rng.uniform(-0.25, 0.25)], np.zeros(3)
        )
        position = np.array([x_mm, 0, distance_mm]) + rng.uniform([-70, -50, -90], [70, 50, 90])
        poses.append(Pose(rotation.rotation, position - rotation.rotation @ middle))
    return poses


@cache
def _texture(board: PlanarBoard, legacy: bool) -> NDArray[np.float32]:
    """Return (rows·_CELL, columns·_CELL) of the printed area, 0 black to 1 white."""
    if isinstance(board, CharucoBoard):
        columns, rows = board.squares
        size = (columns * _CELL, rows * _CELL)
        image = board.to_opencv(legacy=legacy).generateImage(size, marginSize=0).astype(np.float32) / 255
    elif isinstance(board, AprilGrid):
        image = _draw_aprilgrid(board).astype(np.float32) / 255
    else:
        columns, rows = board.grid[0] + 1, board.grid[1] + 1
        dark = np.indices((rows, columns)).sum(axis=0) % 2 == 0
        image = np.kron(~dark, np.ones((_CELL, _CELL))).astype(np.float32)
    return np.pad(image, _CELL, constant_values=1.0).astype(np.float32)


def _draw_aprilgrid(board: AprilGrid) -> NDArray[np.uint8]:
    """Return Kalibr's drawing, _CELL px to ``tag_mm``: tags upside down against OpenCV's, squares between them."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    (columns, rows), gap = board.tags, round(board.spacing * _CELL)
    pitch = _CELL + gap
    image = np.full((gap + rows * pitch, gap + columns * pitch), 255, np.uint8)
    for v in range(0, image.shape[0], pitch):
        for u in range(0, image.shape[1], pitch):
            image[v : v + gap, u : u + gap] = 0
    for number in board.marker_ids:
        row, column = divmod(number - board.first_id, columns)
        v, u = gap + (rows - 1 - row) * pitch, gap + column * pitch
        tag = dictionary.generateImageMarker(number, _CELL, borderBits=board.border_bits)
        image[v : v + _CELL, u : u + _CELL] = tag[::-1, ::-1]
    return image


@cache
def _rays(size_px: tuple[int, int], intrinsics: bytes, model: str) -> NDArray[np.float32]:
    """Return x/z, y/z of all rays (h, w, 2): OpenCV rounds places in the texture to 1/32 of its pixels anyway."""
    values = np.frombuffer(intrinsics)
    lens = Camera("", size_px, values[:2], values[2:4], values[4:], model)
    width, height = size_px
    offset = (np.arange(_SUPER) + 0.5) / _SUPER - 0.5
    u = (np.arange(width)[:, None] + offset).ravel()
    v = (np.arange(height)[:, None] + offset).ravel()
    pixels = np.stack(np.meshgrid(u, v), axis=-1)
    rays = _undistort_fisheye(lens, pixels) if model == "fisheye" else lens.undistort(pixels)
    return rays.astype(np.float32)


def _undistort_fisheye(lens: Camera, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return x/z, y/z by a table of the radius: the general inversion takes seconds for millions of rays."""
    angle = np.linspace(1e-6, 1.5, 50_001)
    rays = np.column_stack([np.tan(angle), np.zeros_like(angle), np.ones_like(angle)])
    radius = (lens.project(rays) - lens.center_px)[:, 0] / lens.focal_px[0]
    off = (pixels - lens.center_px) / lens.focal_px
    length = np.maximum(np.linalg.norm(off, axis=-1, keepdims=True), 1e-9)
    return off / length * np.tan(np.interp(length, radius, angle))


def view(
    lens: Camera, cam_from_board: Pose, board: PlanarBoard, how: Print | None = None
) -> NDArray[np.uint8]:
    """Return (H, W) uint8, the image of the board; grey beside it."""
    how = how or Print()
    intrinsics = np.concatenate([lens.focal_px, lens.center_px, lens.distortion]).tobytes()
    rays = _rays(lens.size_px, intrinsics, lens.model)
    # a point on the board's plane is hit by the ray  H⁻¹ (x, y, 1)
    r, t = cam_from_board.rotation, cam_from_board.translation_mm
    to_board = np.linalg.inv(np.column_stack([r[:, 0], r[:, 1], t]))
    scale, first = _CELL / board.square_mm, _CELL - 0.5
    to_texture = np.array([[scale, 0, first], [0, scale, first], [0, 0, 1]]) @ to_board
    texture = _texture(board, how.legacy)
    printed = 1 - texture if how.inverted else texture
    seen = cv2.remap(
        printed, cv2.perspectiveTransform(rays, to_texture), None, cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT, borderValue=0.55,
    )  # fmt: skip
    light = 30 + 190 * cv2.resize(seen, lens.size_px, interpolation=cv2.INTER_AREA).astype(np.float64)
    light = cv2.GaussianBlur(light, (0, 0), how.blur_px)
    noise = np.random.default_rng(how.seed).normal(0, how.noise, light.shape)
    return np.clip(np.rint(light + noise), 0, 255).astype(np.uint8)


@dataclass
class BoardCapture:
    """A capture of one board by one rig, and its truth."""

    folder: Path
    rig: Rig
    board: PlanarBoard
    poses: Mapping[str, Pose]
    """core_from_board by frame."""
    how: Print = field(default_factory=Print)

    def render(self, name: str, frame: str) -> NDArray[np.uint8]:
        number = list(self.rig.cameras).index(name) * 1000 + list(self.poses).index(frame)
        how = Print(
            self.how.legacy, self.how.inverted, self.how.blur_px, self.how.noise, self.how.seed + number
        )
        return view(self.rig.cameras[name], self.rig.cam_from_core[name] @ self.poses[frame], self.board, how)

    def write(self, seen_by: Mapping[str, Iterable[str]] | None = None) -> BoardCapture:
        """Write the images; ``seen_by`` lists each camera's frames, by default all."""
        for name in self.rig.cameras:
            for frame in self.poses if seen_by is None else seen_by[name]:
                write_image(self.folder / name / f"{frame}.png", self.render(name, frame))
        return self


def capture(
    folder: Path, rig: Rig, board: PlanarBoard, poses: Sequence[Pose], how: Print | None = None,
    seen_by: Mapping[str, Iterable[str]] | None = None,
) -> BoardCapture:  # fmt: skip
    """Render and write a capture with the frames 00, 01, …"""
    return BoardCapture(folder, rig, board, name_frames(poses), how or Print()).write(seen_by)


def name_frames(poses: Sequence[Pose]) -> dict[str, Pose]:
    """Return the poses by frame: 00, 01, …"""
    return {f"{i:02d}": pose for i, pose in enumerate(poses)}
