"""Depth on the core's grid from one rectified pair: OpenCV's semi-global block matching, corrected for bias."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.camera import Camera
from beltscape.core.rig import Rig
from beltscape.stereo.pairwise.contrast import equalise_contrast
from beltscape.stereo.pairwise.rectification import RectifiedPair, rectify_pair
from beltscape.stereo.pairwise.settings import PairwiseSettings

_SAME_SURFACE_PX = 0.75
"""Neighbouring disparities farther apart than this lie on different surfaces and are not interpolated."""

_FLAT_PX = 7


@dataclass(frozen=True, slots=True, eq=False)
class PairMatcher:
    """Everything about one pair that does not change from frame to frame."""

    pair: RectifiedPair
    settings: PairwiseSettings
    aux_seen: NDArray[np.bool_]
    """(H, W): rectified auxiliary pixels that lie inside the auxiliary's image."""
    sample_map: NDArray[np.float32]
    """(h, w, 2) float32: where each pixel of the core's pinhole grid lies in the rectified view."""
    depth_ratio: NDArray[np.float32]
    """(h, w) float32: rectified depth over core depth."""

    def disparity(self, core_root: NDArray[np.float32], aux_root: NDArray[np.float32]) -> NDArray[np.float32]:
        """(H, W) float32 disparity of the rectified core view, px; NaN where not measured."""
        left, right = (
            equalise_contrast(_rectified(root, source), self.settings.contrast_radius_px)
            for root, source in ((core_root, self.pair.core_map), (aux_root, self.pair.aux_map))
        )
        sixteenths = _sgbm(self.settings, self.pair.disparities).compute(left, right)
        disparity = correct_bias(sixteenths)
        disparity[mask_featureless(left)] = np.nan
        columns = np.arange(disparity.shape[1], dtype=np.float32)
        matched = np.rint(columns - np.nan_to_num(disparity)).astype(np.intp)
        disparity[~np.take_along_axis(self.aux_seen, np.maximum(matched, 0), axis=1)] = np.nan
        return disparity

    def depth(self, core_root: NDArray[np.float32], aux_root: NDArray[np.float32]) -> NDArray[np.float32]:
        """(h, w) float32 depth along the core's optical axis on its pinhole grid, mm; NaN = not measured.

        The arguments are the square-rooted luminances (`square_root`) of the distorted images.
        """
        disparity = sample_values(self.disparity(core_root, aux_root), self.sample_map)
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
        aux_seen=_inside(pair.aux_map, rig.cameras[auxiliary]),
        sample_map=pixels.astype(np.float32),
        depth_ratio=ratio.astype(np.float32),
    )


def correct_bias(sixteenths: NDArray[np.int16]) -> NDArray[np.float32]:
    """OpenCV's fixed-point disparity → px, without the bias of its rounding; NaN where it is negative.

    SGBM adds half a unit to the parabola's offset and lets integer division cut towards zero, which rounds
    offsets left of the best whole disparity up by a whole unit of 1/16 px and those next to zero by half of one.
    """
    fraction = sixteenths & 15
    high = np.where(fraction > 8, 1.0, np.where((fraction == 0) | (fraction == 8), 0.5, 0.0))
    disparity = ((sixteenths - high) / 16.0).astype(np.float32)
    disparity[sixteenths < 0] = np.nan
    return disparity


def mask_featureless(image: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """(H, W) bool: all counts about the pixel are one: black, saturated, nothing SGBM could tell apart."""
    window = np.ones((_FLAT_PX, _FLAT_PX), np.uint8)
    return np.asarray(cv2.dilate(image, window)) == np.asarray(cv2.erode(image, window))


def sample_values(values: NDArray[np.float32], source: NDArray[np.float32]) -> NDArray[np.float32]:
    """Values at sub-pixel positions (h, w, 2): bilinear on a surface, the nearest one at steps and gaps."""
    nearest = _remap(values, source, cv2.INTER_NEAREST)
    smooth = _remap(values, source, cv2.INTER_LINEAR)
    return np.where(np.abs(smooth - nearest) <= _SAME_SURFACE_PX, smooth, nearest)


def _remap(values: NDArray[np.float32], source: NDArray[np.float32], how: int) -> NDArray[np.float32]:
    return np.asarray(
        cv2.remap(values, source, None, how, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan), np.float32
    )


def _rectified(root: NDArray[np.float32], source: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(cv2.remap(root, source, None, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE))


def _inside(source: NDArray[np.float32], camera: Camera) -> NDArray[np.bool_]:
    return np.all((source >= 0) & (source <= np.array(camera.size_px) - 1), axis=-1)


def _sgbm(settings: PairwiseSettings, disparities: int) -> cv2.StereoSGBM:
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
