"""Depth on the core's grid from one rectified pair: OpenCV's semi-global block matching, corrected for bias."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.rig import Rig
from beltscape.stereo.pairwise.rectification import RectifiedPair, equalise_contrast, rectify_pair
from beltscape.stereo.settings import PairwiseSettings

_SAME_SURFACE_PX = 0.75
"""Neighbouring disparities that differ by more lie on different surfaces and are not interpolated."""
_FLAT_PX = 7
"""Edge of the window that counts as featureless when all its levels are equal."""


@dataclass(frozen=True, slots=True, eq=False)
class PairMatcher:
    """The matcher of one pair, with all that does not depend on the frame."""

    pair: RectifiedPair
    settings: PairwiseSettings
    aux_mask: NDArray[np.bool_]
    """(H, W) rectified auxiliary pixels that lie inside the auxiliary's image."""
    sample_map: NDArray[np.float32]
    """(h, w, 2) float32: rectified pixel of each pixel of the core's pinhole grid."""
    depth_ratio: NDArray[np.float32]
    """(h, w) float32: rectified depth over core depth."""

    def compute_disparity(
        self, core_root: NDArray[np.float32], aux_root: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Return the (H, W) float32 disparity of the rectified core view, px; NaN where not measured."""
        left, right = (
            equalise_contrast(_rectify(root, source), self.settings.contrast_radius_px)
            for root, source in ((core_root, self.pair.core_map), (aux_root, self.pair.aux_map))
        )
        sixteenths = _make_sgbm(self.settings, self.pair.disparities).compute(left, right)
        disparity = correct_bias(sixteenths)
        disparity[mask_featureless(left)] = np.nan
        columns = np.arange(disparity.shape[1], dtype=np.float32)
        aux_columns = np.rint(columns - np.nan_to_num(disparity)).astype(np.intp)
        disparity[~np.take_along_axis(self.aux_mask, np.maximum(aux_columns, 0), axis=1)] = np.nan
        return disparity

    def compute_depth(
        self, core_root: NDArray[np.float32], aux_root: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Return the (h, w) float32 depth along the core's optical axis on its pinhole grid, mm; NaN = not measured.

        The arguments are the distorted images after `take_square_root`.
        """
        disparity = sample_values(self.compute_disparity(core_root, aux_root), self.sample_map)
        return (self.pair.depth_from_disparity(disparity) / self.depth_ratio).astype(np.float32)


def make_pair_matcher(
    rig: Rig, auxiliary: str, depth_range_mm: tuple[float, float], settings: PairwiseSettings
) -> PairMatcher:
    """Prepare one pair; see `rectify_pair` for the errors."""
    sampling = settings.choose_oversampling(rig.core_camera.size_px[0])
    pair = rectify_pair(rig, auxiliary, depth_range_mm, oversampling=sampling)
    pixels, ratio = pair.project_core_rays(rig.core_camera.rays())
    return PairMatcher(
        pair=pair,
        settings=settings,
        aux_mask=_mask_inside(pair.aux_map, rig.cameras[auxiliary]),
        sample_map=pixels.astype(np.float32),
        depth_ratio=ratio.astype(np.float32),
    )


def correct_bias(sixteenths: NDArray[np.int16]) -> NDArray[np.float32]:
    """Return OpenCV's fixed-point disparity in px, without the bias of its rounding; NaN where it is negative.

    SGBM adds half a unit to the parabola's offset, and its integer division truncates towards zero. This rounds
    negative offsets up by a whole unit of 1/16 px, and offsets next to zero by half of one.
    """
    fraction = sixteenths & 15
    excess = np.where(fraction > 8, 1.0, np.where((fraction == 0) | (fraction == 8), 0.5, 0.0))
    disparity = ((sixteenths - excess) / 16.0).astype(np.float32)
    disparity[sixteenths < 0] = np.nan
    return disparity


def mask_featureless(image: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return the (H, W) mask of pixels whose window has equal levels, such as black or saturated ones."""
    window = np.ones((_FLAT_PX, _FLAT_PX), np.uint8)
    return np.asarray(cv2.dilate(image, window)) == np.asarray(cv2.erode(image, window))


def sample_values(values: NDArray[np.float32], source: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return values at subpixel positions (h, w, 2): bilinear on a surface, nearest neighbour at steps and gaps."""
    nearest = _remap(values, source, cv2.INTER_NEAREST)
    smooth = _remap(values, source, cv2.INTER_LINEAR)
    return np.where(np.abs(smooth - nearest) <= _SAME_SURFACE_PX, smooth, nearest)


def _remap(
    values: NDArray[np.float32], source: NDArray[np.float32], interpolation: int
) -> NDArray[np.float32]:
    return np.asarray(
        cv2.remap(values, source, None, interpolation, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan),
        np.float32,
    )


def _rectify(root: NDArray[np.float32], source: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(cv2.remap(root, source, None, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE))


def _mask_inside(source: NDArray[np.float32], camera: Camera) -> NDArray[np.bool_]:
    return np.all((source >= 0) & (source <= np.array(camera.size_px) - 1), axis=-1)


def _make_sgbm(settings: PairwiseSettings, disparities: int) -> cv2.StereoSGBM:
    area = settings.block_px**2
    return cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=disparities,
        blockSize=settings.block_px,
        P1=round(settings.step_penalty * area),
        P2=round(settings.jump_penalty * area),
        disp12MaxDiff=settings.left_right_px,
        preFilterCap=settings.gradient_cap,
        uniquenessRatio=settings.uniqueness_percent,
        speckleWindowSize=settings.speckle_area_px,
        speckleRange=settings.speckle_step_px,
        mode=cv2.STEREO_SGBM_MODE_SGBM,
    )
