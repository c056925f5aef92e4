"""Pictures of a printed board before running cameras: a ray per sub-pixel through the true lens onto the board.

They take a fraction of a second, without a renderer of light: even light on the print, a camera's own picture beside
it. What they are for is the geometry of corners, which is exact.
"""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import Image
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.simulate.solids.board import BLACK, WHITE, make_print_texture
from beltscape.target.planar_boards import SquareBoard

_SUPER = 2
"""Rays per pixel edge: with the lens's blur and texels of that size the corners are then right to 0.005 px RMS."""
_BLUR_PX, _NOISE = 0.6, 1.0
"""σ of the lens's blur, and of the sensor's noise in grey levels; as in the captures that ship."""
_LEAST_TEXELS = 64
"""Texels across the coarsest level of the print: boards of fewer pixels are not found."""
_LEVELS = (28.0, 205.0)
"""Grey levels of ink and paper."""


class BoardPictures:
    """Renders a board at any pose before the cameras of a known rig."""

    def __init__(self, rig: Rig, board: SquareBoard, backgrounds: Mapping[str, Image]) -> None:
        """``backgrounds``: (H, W) uint8 by camera, what is seen beside the board."""
        self._rig, self._backgrounds = rig, backgrounds
        texture, texel_mm, self._margin_mm = make_print_texture(board, board.square_mm)
        light = (texture[..., 0] - BLACK) / (WHITE - BLACK)
        self._prints = _make_pyramid(np.asarray(_LEVELS[0] + (_LEVELS[1] - _LEVELS[0]) * light, np.float32))
        self._texels_mm = [texel_mm * 2**level for level in range(len(self._prints))]
        self._middle_mm = np.append(np.array(board.grid) + 1.0, 0.0) * board.square_mm / 2
        self._rays = {name: _cast_rays(lens) for name, lens in rig.cameras.items()}

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the rig's cameras."""
        return tuple(self._rig.cameras)

    def render(self, core_from_board: Mapping[str, Pose] | Pose, seed: int) -> dict[str, Image]:
        """Return each camera's picture (H, W) uint8; a pose for each camera is where the board is when it exposes."""
        poses = (
            dict.fromkeys(self.cameras, core_from_board)
            if isinstance(core_from_board, Pose)
            else core_from_board
        )
        return {
            name: self._render(
                name, self._rig.cam_from_core[name] @ poses[name], seed * len(self.cameras) + k
            )
            for k, name in enumerate(self.cameras)
        }

    def _render(self, name: str, cam_from_board: Pose, seed: int) -> Image:
        size = self._rig.cameras[name].size_px
        r, t = cam_from_board.rotation, cam_from_board.translation_mm
        seen = np.full((size[1] * _SUPER, size[0] * _SUPER), np.nan, np.float32)
        if r[:, 2] @ t > 0 and t[2] > 0:  # the print faces the camera
            level = self._choose_level(name, float(cam_from_board.apply(self._middle_mm)[2]))
            to_texels = np.array(
                [[1, 0, self._margin_mm], [0, 1, self._margin_mm], [0, 0, 1]]
            ) @ np.linalg.inv(np.column_stack([r[:, 0], r[:, 1], t]))
            to_texels = np.diag([1 / self._texels_mm[level], 1 / self._texels_mm[level], 1.0]) @ to_texels
            places = cv2.perspectiveTransform(self._rays[name], to_texels) - np.float32(0.5)
            seen = cv2.remap(
                self._prints[level],
                places,
                None,
                cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_CONSTANT,
                borderValue=np.nan,
            )
        return self._develop(self._backgrounds[name], seen, seed)

    def _choose_level(self, name: str, distance_mm: float) -> int:
        """Return the finest level of the print whose texels are no smaller than the rays are apart at a distance."""
        ray_mm = distance_mm / (float(self._rig.cameras[name].focal_px.mean()) * _SUPER)
        return min(int(np.searchsorted(self._texels_mm, ray_mm)), len(self._prints) - 1)

    def _develop(self, background: Image, seen: NDArray[np.float32], seed: int) -> Image:
        """Return the picture of the light on the sub-pixels; NaN: the background's."""
        height, width = background.shape
        behind = np.repeat(np.repeat(background.astype(np.float32), _SUPER, axis=0), _SUPER, axis=1)
        fine = np.where(np.isfinite(seen), cv2.GaussianBlur(
            np.nan_to_num(seen, nan=_LEVELS[1]), (0, 0), _BLUR_PX * _SUPER), behind)  # fmt: skip
        light = fine.reshape(height, _SUPER, width, _SUPER).mean(axis=(1, 3))
        noise = np.random.default_rng(seed).normal(0.0, _NOISE, light.shape) * np.isfinite(
            seen[::_SUPER, ::_SUPER]
        )
        return np.clip(np.rint(light + noise), 0, 255).astype(np.uint8)


def _make_pyramid(fine: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    """Return the print in ever coarser texels, each the mean of four of the level before.

    A ray between fine texels meets ink or paper and misses where the edge lies: corners are then off by 0.03 px RMS.
    """
    levels = [fine]
    while min(levels[-1].shape) >= 2 * _LEAST_TEXELS:
        rows, columns = (size + size % 2 for size in levels[-1].shape)
        whole = np.pad(
            levels[-1], ((0, rows - levels[-1].shape[0]), (0, columns - levels[-1].shape[1])), mode="edge"
        )
        levels.append(whole.reshape(rows // 2, 2, columns // 2, 2).mean(axis=(1, 3), dtype=np.float32))
    return levels


def _cast_rays(lens: Camera) -> NDArray[np.float32]:
    """Return x/z, y/z (H·n, W·n, 2) of the rays of all sub-pixels, n = `_SUPER`."""
    width, height = lens.size_px
    u, v = ((np.arange(count * _SUPER) + 0.5) / _SUPER - 0.5 for count in (width, height))
    return lens.undistort(np.stack(np.meshgrid(u, v), axis=-1)).astype(np.float32)
