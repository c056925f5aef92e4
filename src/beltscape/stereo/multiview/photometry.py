"""Grey levels of a frame's images, equalised in channel, contrast and sharpness, and the noise in them.

Where the core is defocused, the auxiliaries are blurred to match, since sharp and blurred texture do not correlate.

Images interpolated from a colour filter array are detected by their 2 × 2 pattern of sharpness.
A demosaiced image repeats, with a period of two pixels, which colour of a pixel was measured and which was
interpolated. Measured values differ more from their neighbours than interpolated ones do. The pattern survives the
conversion to grey and JPEG compression; no scene has a structure that follows the pixel grid in this way.

References
----------
Gallagher & Chen, Image authentication by detecting traces of demosaicing, CVPR Workshops 2008,
doi:10.1109/CVPRW.2008.4562984.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cache, partial, reduce
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import Image
from beltscape.core.statistics import compute_quantile
from beltscape.kernels import Kernels, load_on_processor
from beltscape.kernels.photometry import choose_radius, measure_phases, weigh_window
from beltscape.kernels.planes import average_areas, blur, measure_moments, to_single
from beltscape.kernels.statistics import find_statistics_kernels
from beltscape.stereo.multiview.parallel import run_parallel

WINDOW_PX = 7
"""Radius of the window in which levels are normalised."""
_WINDOW = 2 * WINDOW_PX + 1, 2 * WINDOW_PX + 1
"""Its width and height."""
_FULL = 255.0
"""Levels are given in 8-bit counts for images of any bit depth."""
_QUANTISATION = 1.0 / np.sqrt(12.0)
"""σ of rounding to whole levels."""
GAIN = (0.5, 2.0)
"""Range of the gain by which a camera's levels are multiplied."""
_QUIET = 0.2
"""Quantile of the blocks that represents the image's parts of least texture."""
_BLOCK_PX = 16
"""Side of the blocks in which the noise is estimated."""
_BRIGHTEST = 8.0
"""Largest ratio of the noise variance of a bright region to that of the quietest blocks."""
_LAPLACIAN = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
"""Difference of two Laplacians, blind to planes of brightness (Immerkær 1996)."""


def compute_grey_levels(
    images: Mapping[str, Image], core: str, kernels: Kernels | None = None, threads: int = 1
) -> dict[str, NDArray[np.float32]]:
    """Return (H, W) float32 levels of every camera in 8-bit counts, with the contrast of the core.

    Colour channels are weighted by their contrast over all cameras. Where the noise of all channels is the same, this
    gives the best single image of a coloured pattern.
    """
    weights = compute_channel_weights(images.values())
    kernels = kernels or load_on_processor()

    def measure(image: Image) -> tuple[NDArray[np.float32] | None, float]:
        if image.ndim == 2:
            return None, float(kernels.measure_contrast(image))
        level = mix_channels(image, weights)
        return level, float(level.std())

    measured = run_parallel([partial(measure, each) for each in images.values()], threads)
    found = dict(zip(images, measured, strict=True))
    _, core_contrast = found[core]

    def scale(name: str) -> NDArray[np.float32]:
        level, contrast = found[name]
        gain = float(np.clip(core_contrast / contrast, *GAIN)) if contrast else 1.0
        return kernels.make_levels(images[name], gain) if level is None else level * np.float32(gain)

    return dict(zip(images, run_parallel([partial(scale, name) for name in images], threads), strict=True))


def estimate_noise_variance(level: NDArray[np.float32]) -> Any:
    """Return the noise variance, levels², of the least textured fifth of an image; at least that of 8 bits.

    On a GPU, where the image is, it is a number ().

    References
    ----------
    Immerkær, Fast noise variance estimation, CVIU 64(2), 1996, doi:10.1006/cviu.1996.0060.
    """
    quiet = measure_quiet_edges(level)
    if find_statistics_kernels(level):
        sigma = quiet * float(np.sqrt(np.pi / 2) / 6)
        return np.square(np.maximum(sigma, float(_QUANTISATION)))
    return compute_noise_variance(quiet)


def measure_quiet_edges(level: NDArray[np.float32]) -> Any:
    """Return the mean absolute Laplacian in the least textured fifth of an image: a number, on a GPU where it is."""
    size = (max(1, level.shape[1] // _BLOCK_PX), max(1, level.shape[0] // _BLOCK_PX))
    kernels = find_statistics_kernels(level)
    if kernels:
        blocks = average_areas(np.abs(kernels.filter_plane(level, _LAPLACIAN)), size)
        return kernels.find_quantile([blocks], _QUIET)
    edges = cv2.filter2D(level, -1, _LAPLACIAN)
    return compute_quantile(average_areas(np.abs(edges, out=edges), size), _QUIET)


def compute_noise_variance(quiet: float) -> float:
    """Return the noise variance, levels², by the mean absolute Laplacian where there is no texture."""
    sigma = quiet * np.sqrt(np.pi / 2) / 6
    return max(sigma, _QUANTISATION) ** 2


def compute_local_mean(level: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the (H, W) float32 mean within `WINDOW_PX` around each pixel."""
    return blur(level, _WINDOW, repeat_edge=True)


def compute_local_variance(level: NDArray[np.float32], stride: int = 1) -> NDArray[np.float32]:
    """Return the float32 variance, levels², in the window of `compute_local_mean` of every ``stride``-th pixel."""
    return compute_local_moments(level, stride)[1]


def compute_local_moments(
    level: NDArray[np.float32], stride: int = 1
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return mean and variance, levels², in the window of `compute_local_mean` of every ``stride``-th pixel."""
    if stride == 1:
        return measure_moments(level, _WINDOW, repeat_edge=True)
    mean, square = (compute_local_mean(x)[::stride, ::stride] for x in (level, level * level))
    return mean, np.maximum(square - mean * mean, 0)


def compute_box_moments(
    image: NDArray[np.float32], box: tuple[int, int]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the (H, W) mean and (H, W) variance in windows of (width, height) ``box``."""
    return measure_moments(image, box)


def compute_texture_ratio(level: NDArray[np.float32], noise: float, side: int) -> NDArray[np.float32]:
    """Return the (H, W) variance of the levels in windows of ``side`` px over that of noise.

    The variance that a plane explains is subtracted: linear shading does not identify a pixel. Bright regions are
    noisier than ``noise``, the variance of the quietest blocks; their noise is estimated from the Laplacian.
    """
    reach = np.arange(side, dtype=np.float32) - side // 2
    even, slope = np.full(side, 1 / side, np.float32), reach / np.square(reach).sum()
    mean, square = (blur(x, (side, side), repeat_edge=True) for x in (level, level * level))
    across, down = (_filter_separably(level, *each) for each in ((slope, even), (even, slope)))
    texture = square - mean * mean - (across * across + down * down) * np.square(reach).mean()
    edges = _filter(level, _LAPLACIAN)
    rough = compute_local_mean(np.abs(edges, out=edges)) * np.float32(np.sqrt(np.pi / 2) / 6)
    rough *= rough
    if find_statistics_kernels(level):
        noise = to_single(noise)
    ratio = texture / rough.clip(noise / _BRIGHTEST, noise * _BRIGHTEST, out=rough)
    return ratio.astype(np.float32, copy=False)


def _filter(level: NDArray[np.float32], weights: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the sums (H, W) over windows with weights (h, w), where the level is."""
    kernels = find_statistics_kernels(level)
    return kernels.filter_plane(level, weights) if kernels else cv2.filter2D(level, -1, weights)


def _filter_separably(
    level: NDArray[np.float32], across: NDArray[np.float32], down: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the sums (H, W) over windows with weights (w,) along rows and (h,) along columns."""
    kernels = find_statistics_kernels(level)
    if kernels:
        return kernels.filter_plane(level, np.outer(down, across), repeat_edge=True)
    return cv2.sepFilter2D(level, cv2.CV_32F, across, down, borderType=cv2.BORDER_REPLICATE)


def compute_channel_weights(images: Iterable[Image]) -> NDArray[np.float32]:
    """Return the weights (3,) of colour channels by their mean contrast over the images of colours."""
    contrasts = [cv2.meanStdDev(_subsample(image))[1].ravel() for image in images if image.ndim == 3]
    contrast = np.mean(contrasts, axis=0) if contrasts else np.zeros(3)
    total = float(contrast.sum())
    return (contrast / total if total > 0 else np.full(3, 1 / 3)).astype(np.float32)


def _subsample(image: Image) -> NDArray[np.integer]:
    return np.ascontiguousarray(image[::4, ::4, :3])


def mix_channels(image: Image, weights: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the levels (H, W) in counts of 8 bits of an image of colours (H, W, 3), by weights (3,)."""
    scale = np.float32(_FULL / np.iinfo(image.dtype).max)
    # cv2.transform mixes the channels of 8 and 16 bit images without a float copy of all three
    mixed = cv2.transform(image[..., :3].astype(np.float32), (weights * scale)[None])
    return np.ascontiguousarray(mixed, dtype=np.float32)


Level = NDArray[np.float32]

BLURS_PX = tuple(float(blur_px) for blur_px in np.arange(1.5, 4.01, 0.25))
"""Blurs that are tried. A smaller difference does no harm; sound rigs and scenes differ by up to one pixel."""
_FINE_PX, _MIDDLE_PX = 1.0, 3.0
"""Sharpness is the variance of texture finer than the first blur over that between the two blurs."""
DEFOCUS_SHARE = 0.75
"""Share of the estimated blur that is applied: slightly sharper auxiliaries match better (0.5 to 1 were tried)."""
_ROWS = 160
"""Number of rows in the middle of the image that are examined."""


def match_defocus(
    core: str, levels: Mapping[str, Level], kernels: Kernels | None = None, threads: int = 1
) -> dict[str, Level]:
    """Return levels (H, W) by camera, the auxiliaries blurred where ``core`` is out of focus compared with them."""
    others = [level for name, level in levels.items() if name != core]
    blur_px = DEFOCUS_SHARE * estimate_defocus(levels[core], others, kernels, threads)
    return {name: level if name == core else blur_level(level, blur_px) for name, level in levels.items()}


def estimate_defocus(
    core: Level, others: Sequence[Level], kernels: Kernels | None = None, threads: int = 1
) -> float:
    """Return the sigma (px) of the Gaussian that makes the median auxiliary no sharper than the core.

    It is 0 where less than 1.5 px suffices, and 4 where more is needed.
    """
    kernels = kernels or load_on_processor()
    measure = partial(measure_sharpness, kernels)
    core_sharpness = measure(core, 0.0)
    for blur_px in BLURS_PX:
        jobs = [partial(measure, other, blur_px) for other in others]
        if np.median(run_parallel(jobs, threads)) <= core_sharpness:
            return 0.0 if blur_px == BLURS_PX[0] else blur_px
    return BLURS_PX[-1]


def measure_sharpness(kernels: Kernels, level: Level, blur_px: float) -> Any:
    """Return the variance of fine texture over that of medium texture after a blur, with noise subtracted.

    It is that of an image's middle rows; on a GPU, where the image is, a number (1,).
    """
    band = _select_middle_rows(level)
    sigmas_px = blur_px, float(np.hypot(blur_px, _FINE_PX)), float(np.hypot(blur_px, _MIDDLE_PX))
    fine, medium = kernels.measure_sharpness(band, sigmas_px).reshape(2, 1)
    of_noise = estimate_noise_variance(band) * _compute_noise_gain(*sigmas_px[:2])
    if find_statistics_kernels(level):
        return np.where(medium > 0, np.maximum(fine - of_noise, 0.0) / medium, 0.0)
    return max(float(fine[0]) - of_noise, 0.0) / float(medium[0]) if medium[0] > 0 else 0.0


@cache
def _compute_noise_gain(narrow_px: float, wide_px: float) -> float:
    """Return the share of white noise's variance that passes a difference of two Gaussians."""
    impulse = np.zeros((41, 41), np.float32)
    impulse[20, 20] = 1
    return float(np.square(blur_level(impulse, narrow_px) - blur_level(impulse, wide_px)).sum())


def _select_middle_rows(level: Level) -> Level:
    start = max(0, (len(level) - _ROWS) // 2)
    return level[start : start + _ROWS]


def blur_level(level: Level, sigma_px: float) -> Level:
    """Return an image (H, W) blurred by a Gaussian, where the image is."""
    if sigma_px == 0:
        return level
    kernels = find_statistics_kernels(level)
    if kernels is None:
        return np.asarray(cv2.GaussianBlur(level, (0, 0), sigma_px), np.float32)
    half = weigh_window(choose_radius(sigma_px), sigma_px)
    weights = np.append(half[:0:-1], half)
    return kernels.filter_plane(kernels.filter_plane(level, weights[None]), weights[:, None])


_RATIO = 1.07
"""Ratio of the sharpest to the least sharp of the four pixel phases: at most 1.04 in simulated images of three
sensors or one, 1.4 and more after OpenCV's demosaicing methods, 1.1 and more after JPEG of quality 90 besides, where
dots are up to 5 px wide."""
_CHANCE = 2.0
"""Added to the ratio per root of the pixels of a phase: small images differ more by chance."""
_PIXELS = 80_000
"""Size of the band of rows that is examined."""


def are_demosaiced(levels: Iterable[NDArray[np.float32]]) -> bool:
    """Return whether most of the images (H, W) show the pattern of demosaicing."""
    is_periodic = [compute_phase_ratio(level) > find_least_ratio(level.shape) for level in levels]
    return bool(sum(is_periodic) > len(is_periodic) / 2)


def find_least_ratio(shape: tuple[int, ...]) -> float:
    """Return the ratio of `compute_phase_ratio` above which an image of this shape shows the pattern."""
    rows = _find_middle_rows(shape)
    return float(_RATIO + _CHANCE / np.sqrt((rows.stop - rows.start) * shape[1] / 4))


def compute_phase_ratio(level: NDArray[np.float32]) -> Any:
    """Return the ratio of sharpness between the sharpest and the least sharp of the 2 × 2 pixel phases.

    The sharpness of a phase is the mean absolute difference of its pixels to their four neighbours, in the middle
    rows of the image (H, W). On a GPU, where the image is, the ratio is a number (1,).
    """
    band = level[_find_middle_rows(level.shape)]
    sharpness = measure_phases(band)
    if find_statistics_kernels(level):
        phases = list(sharpness.reshape(4, 1))
        least, most = reduce(np.minimum, phases), reduce(np.maximum, phases)
        return np.where(least > 0, most / least, 1.0)
    least, most = float(sharpness.min()), float(sharpness.max())
    return most / least if least > 0 else 1.0


def _find_middle_rows(shape: tuple[int, ...]) -> slice:
    """Return the middle rows of an image (H, W)."""
    rows = max(2, _PIXELS // shape[1])
    start = max(0, (shape[0] - rows) // 2)
    return slice(start, min(shape[0], start + rows))
