"""From a frame set's images to the frame that is matched, on the processor or on a GPU.

On a GPU the images stay as the cameras gave them until their levels are computed there. What the processor decides
by a few numbers, whether the core is out of focus and whether the images are demosaiced, hardly ever changes what was
prepared before the numbers were known. The noise is computed from them in double precision, as without a GPU.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import FrameSet, Image
from beltscape.kernels import FrameNumbers, Kernels
from beltscape.stereo.multiview.frame import (
    MODEL_VARIANCE,
    MatchContext,
    Noise,
    PreparedFrame,
    downsample,
    find_strongest_texture,
)
from beltscape.stereo.multiview.photometry import (
    BLURS_PX,
    DEFOCUS_SHARE,
    GAIN,
    are_demosaiced,
    blur_level,
    compute_channel_weights,
    compute_grey_levels,
    compute_noise_variance,
    compute_phase_ratio,
    estimate_noise_variance,
    find_least_ratio,
    match_defocus,
    measure_quiet_edges,
    measure_sharpness,
    mix_channels,
)
from beltscape.stereo.multiview.surface import pack_projection, pack_projections

Level = NDArray[np.float32]


def prepare_frame(frame_set: FrameSet, context: MatchContext) -> PreparedFrame:
    """Return a frame on the grid of ``context``, whose pixels average blocks of its ``step`` image pixels."""
    rig = context.rig
    images = {name: frame_set.images[name] for name in (rig.core, *context.auxiliaries)}
    own_view = pack_projection(rig, rig.core, context.inverse_depth_scale, context.step, context.step)
    if context.kernels.is_resident:
        return _prepare_on_gpu(images, own_view, context)
    kernels, threads = context.kernels, context.threads
    taken = compute_grey_levels(images, rig.core, kernels, threads)
    raw, demosaiced = estimate_noise_variance(taken[rig.core]), are_demosaiced(taken.values())
    levels = {name: downsample(level, context.step) for name, level in taken.items()}
    levels = match_defocus(rig.core, levels, kernels, threads)
    noise = Noise(raw / context.step**2, MODEL_VARIANCE, 0.0, demosaiced)
    others = tuple(levels[name] for name in context.auxiliaries)
    return _place_on_grid(levels[rig.core], others, own_view, noise, context)


def _place_on_grid(
    core: Level, images: tuple[Level, ...], own_view: NDArray[np.float32], noise: Noise, context: MatchContext
) -> PreparedFrame:
    """Return the frame of levels on the grid of ``context``; ``own_view`` (39,) is the core's own projection.

    The strongest texture is added to the noise.
    """
    kernels, threads = context.kernels, context.threads
    coefficients = kernels.spline_coefficients(core, threads=threads)
    noise = replace(noise, texture=find_strongest_texture(core))
    s = np.zeros_like(core)  # the core's own projection does not depend on the inverse depth
    undistorted, _ = kernels.warp(s, own_view, coefficients, threads=threads)
    return PreparedFrame(
        core=undistorted.astype(np.float32, copy=False),
        images=images,
        coefficients=tuple(kernels.spline_coefficients(image, threads=threads) for image in images),
        views=pack_projections(context.rig, context.auxiliaries, context.inverse_depth_scale, context.step),
        noise=noise,
        context=context,
    )


@dataclass(frozen=True, slots=True, eq=False)
class TakenImage(FrameNumbers):
    """An image as it is copied to a GPU."""

    pixels: NDArray[Any]
    """(H, W) as the camera gave it; the levels, of an image of colours."""
    contrast: float
    """Standard deviation of such levels; of others it is measured on the GPU, and 0 here."""


class _Placed(NamedTuple):
    """A frame that was prepared as if the core were in focus, and what the processor needs to know of it."""

    prepared: PreparedFrame
    """Without its noise."""
    core: Level
    """(H, W) levels as taken, on the grid."""
    others: tuple[Level, ...]
    numbers: NDArray[np.float32]
    """(4, 1, 1) by how much the median auxiliary, blurred least, is sharper than the core; the share of the images
    that are demosaiced; what `measure_quiet_edges` gives for the core; its strongest texture."""


def _prepare_on_gpu(
    images: Mapping[str, Image], own_view: NDArray[np.float32], context: MatchContext
) -> PreparedFrame:
    """Return the frame of images that are copied to the GPU once."""
    kernels, weights = context.kernels, compute_channel_weights(images.values())
    taken = tuple(_take(image, weights, kernels) for image in images.values())
    prepared, core, others, numbers = kernels.replay(_measure_and_place, taken, own_view, context)
    excess, demosaiced_share, quiet, texture = (
        np.asarray(numbers).ravel().tolist()
    )  # the processor waits for it
    raw = compute_noise_variance(quiet) / context.step**2
    noise = Noise(raw, MODEL_VARIANCE, texture, demosaiced_share > 0.5)
    if excess > 0:
        blur_px = DEFOCUS_SHARE * _find_blur(core, others, kernels)
        others = kernels.replay(_blur_levels, others, blur_px)
        prepared = kernels.replay(_place_on_grid, core, others, own_view, noise, context)
    return prepared.with_noise(noise)


def _take(image: Image, weights: NDArray[np.float32], kernels: Kernels) -> TakenImage:
    """Return an image for the GPU; its array is read-only from then on."""
    if image.ndim == 2:
        return TakenImage(kernels.keep(image.view()), 0.0)
    level = mix_channels(image, weights)
    return TakenImage(kernels.keep(level), float(level.std()))


def _measure_and_place(
    images: tuple[TakenImage, ...], own_view: NDArray[np.float32], context: MatchContext
) -> _Placed:
    """Return the frame of images, of which the core's is the first."""
    kernels = context.kernels
    core, *others = _compute_levels(images, kernels)
    ratios = [(compute_phase_ratio(level), find_least_ratio(level.shape)) for level in (core, *others)]
    periodic: Any = sum((ratio > least).astype(np.float32) for ratio, least in ratios)
    quiet = measure_quiet_edges(core)
    core, *others = (kernels.keep(downsample(level, context.step)) for level in (core, *others))
    prepared = _place_on_grid(core, tuple(others), own_view, Noise(0.0, MODEL_VARIANCE, 0.0), context)
    excess = _compare_sharpness(core, tuple(others), BLURS_PX[0], kernels)
    numbers: list[Any] = [excess, periodic / len(images), quiet, prepared.noise.texture]
    first = np.zeros(1, int)
    together = kernels.gather([each.reshape(1, 1) for each in numbers], first, first, np.zeros((1, 2), int))
    return _Placed(prepared, core, tuple(others), together)


def _compute_levels(images: tuple[TakenImage, ...], kernels: Kernels) -> list[Level]:
    """Return the levels (H, W) of images on the GPU, with the contrast of the first."""
    contrasts: list[Any] = [
        image.contrast if image.pixels.dtype == np.float32 else kernels.measure_contrast(image.pixels)
        for image in images
    ]
    levels: list[Level] = []
    for image, contrast in zip(images, contrasts, strict=True):
        gain = np.where(contrast > 0, np.clip(contrasts[0] / contrast, *GAIN), np.float32(1))
        is_level = image.pixels.dtype == np.float32
        levels.append(
            kernels.keep(image.pixels * gain if is_level else kernels.make_levels(image.pixels, gain))
        )
    return levels


def _compare_sharpness(core: Level, others: tuple[Level, ...], blur_px: float, kernels: Kernels) -> Any:
    """Return () by how much the median of images on the GPU, after a blur, is sharper than the core."""
    sharpness = [measure_sharpness(kernels, other, blur_px) for other in others]
    median = kernels.find_quantile(sharpness, 0.5)
    return (median - measure_sharpness(kernels, core, 0.0)).reshape(())


def _find_blur(core: Level, others: tuple[Level, ...], kernels: Kernels) -> float:
    """Return what `beltscape.stereo.multiview.photometry.estimate_defocus` does, for images on the GPU."""
    for blur_px in BLURS_PX[1:]:
        if float(kernels.replay(_compare_sharpness, core, others, blur_px, kernels)) <= 0:
            return blur_px
    return BLURS_PX[-1]


def _blur_levels(levels: tuple[Level, ...], blur_px: float) -> tuple[Level, ...]:
    """Return blurred levels."""
    return tuple(blur_level(level, blur_px) for level in levels)
