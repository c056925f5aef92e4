"""The features after candidate selection: of every pixel, and of the uncertain pixels that are refined.

Every pixel has the initial features, the roughness, the initial confidence around, the photo-consistency, and the
distance from the planes of reliable pixels around; the network of the confidence takes them. The refinement network
also takes the single neighbours of a pixel, and its photo-consistency a little nearer and farther. A feature of a
window is a sum. Where exactly in the window the image changes, the surface leaves a plane or the confidence falls
distinguishes a pixel in front of a step from one behind it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import product

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Floats
from beltscape.kernels import Kernels
from beltscape.kernels.planes import average_areas, blur, dilate, interpolate_plane
from beltscape.stereo.multiview.candidates import Selection
from beltscape.stereo.multiview.features import (
    ConfidenceInputs,
    Features,
    compute_initial_confidence_features,
    limit_confidence,
)
from beltscape.stereo.multiview.frame import MatchContext, PreparedFrame
from beltscape.stereo.multiview.parallel import Pixels, collect_parallel
from beltscape.stereo.multiview.photoconsistency import (
    PhotoConsistencyModel,
    compute_photo_consistency_features,
    compute_photometric_features,
)
from beltscape.stereo.multiview.surface import Surface, fill_nan

_NEAR_PX = (5, 15)
"""Sides, at scale 1, of the windows in which the roughness of a pixel itself is averaged."""
_WIDE_TILES = {41: 11, 101: 25}
"""Sides in px at scale 1, and in tiles, of the windows in which the roughness of the surroundings is averaged."""
_STEP_PX = 5
"""Window around a depth step that is left out of the roughness."""
_TILE_PX = 4
"""Side of the tiles that are averaged before the wide windows."""
_LEAST_SHARE, _LEAST = 1e-3, 0.01
"""Least share of measured pixels, and the offset before the logarithm, against division by and logarithm of zero."""
_MOST_DISTANCE_PX = 10.0
"""Limit of a pixel's distance from the reliable pixels' planes."""
_LEAST_WEIGHT = 1e-4
"""Least sum of weights, against division by zero."""
_STEEPEST = 1.5
"""Limit of the slopes of the reliable pixels' planes."""
_DARK = 8.0
"""Added to levels before the logarithm; differences between darker levels count little."""
_MOST_OFFSET_PX = 3.0
"""Limit of a neighbour's distance from a plane."""
_CENTRE = np.zeros((1, 2), int)
"""The pixel itself, without an offset."""
_OFFSETS = np.array([(du, dv) for dv, du in product((-1, 0, 1), repeat=2) if du or dv])
"""(8, 2) columns and rows to the eight neighbours."""
TRIED_PX = (-1.5, -0.8, -0.4, 0.4, 0.8, 1.5)
"""Shifts of s at which the photo-consistency is evaluated, at scale 1."""


def compute_refined_features(
    inputs: ConfidenceInputs,
    initial_features: Mapping[str, Floats],
    initial_confidence: Floats,
    consistency: PhotoConsistencyModel,
    doubtful: Pixels | None,
) -> dict[str, Floats]:
    """Return the features (H, W) after candidate selection, which gave the initial confidence (H, W), a logit.

    The photo-consistency is evaluated at the doubtful pixels; None: they are not listed yet.
    """
    given = inputs.surface, initial_confidence, consistency, doubtful
    parts = (
        partial(compute_photometric_features, *given),
        partial(compute_reliability_features, inputs, initial_confidence),
        partial(compute_initial_confidence_features, initial_confidence, inputs.windows),
        inputs.image_features.items,
        partial(compute_roughness_features, inputs, initial_features["slope deviation"]),
    )
    # image features stand in the parts' order: a fit depends on the order of the features
    of_surface = {
        name: plane for name, plane in initial_features.items() if name not in inputs.image_features
    }
    return of_surface | collect_parallel(parts, inputs.prepared.context.threads)


def compute_reliability_features(inputs: ConfidenceInputs, initial_confidence: Floats) -> Features:
    """Yield the distance from the planes of reliable pixels around (px at scale 1), and their weight."""
    windows, surface = inputs.windows, inputs.filled
    weight = (1 / (1 + np.exp(-limit_confidence(initial_confidence)))) ** 3
    height, width = weight.shape
    u, v = np.arange(width, dtype=np.float32)[None], np.arange(height, dtype=np.float32)[:, None]
    slope_u, slope_v = (np.clip(slope, -_STEEPEST, _STEEPEST) for slope in (surface.slope_u, surface.slope_v))
    # a plane's value at p is that at the origin + slope · p, so means of planes are planes
    at_origin = surface.s - slope_u * u - slope_v * v
    weighted = [weight, weight * at_origin, weight * slope_u, weight * slope_v]
    for window_px in (7, 15):
        total, constant, across, down = (blur(x, windows.boxes[window_px]) for x in weighted)
        across *= u
        down *= v
        plane_s = (constant + across + down) / np.maximum(total, _LEAST_WEIGHT)
        offset = (surface.s - plane_s) / windows.scale
        np.clip(offset, -_MOST_DISTANCE_PX, _MOST_DISTANCE_PX, out=offset)
        yield f"offset from reliable planes within {window_px}", offset
        yield f"reliable weight within {window_px}", total


def compute_roughness_features(inputs: ConfidenceInputs, slope_deviation: Floats) -> Features:
    """Yield the roughness of the material below the size of the matcher's windows.

    A single pixel does not show it. On rough material the windows of the fit disagree more often than noise
    explains, over a whole stone and over a region of stones. Features are means over the pixels away from depth
    steps at which a view agrees: of the windows' disagreement (its logarithm), of the slope deviation (H, W), which
    is one of the shape features, and of the logarithm of sigma.
    """
    boxes, scale = inputs.windows.boxes, inputs.windows.scale
    step = dilate(inputs.depth_steps.astype(np.uint8), boxes[_STEP_PX])
    used = ((inputs.agreeing > 0) & (step == 0)).astype(np.float32)
    disagreement = used * inputs.disagreement
    for window_px in _NEAR_PX:
        box = boxes[window_px]
        mean = _compute_mean(blur(disagreement, box), blur(used, box))
        yield f"window disagreement within {window_px}", np.log(mean + np.float32(_LEAST))
    log_sigma = 0.5 * np.log(np.clip(inputs.filled_variance, 1e-8, 4.0))
    averaged = used, disagreement, used * slope_deviation, used * log_sigma
    tiles = [_average_tiles(plane, scale) for plane in averaged]
    for window_px, side in _WIDE_TILES.items():
        share, total, *others = (blur(plane, (side, side)) for plane in tiles)
        means = [
            np.log(_compute_mean(total, share) + np.float32(_LEAST)),
            *(_compute_mean(plane, share) for plane in others),
        ]
        names = "window disagreement", "slope deviation", "log sigma"
        for name, plane in zip(names, means, strict=True):
            yield f"{name} within {window_px}", interpolate_plane(plane, used.shape[::-1])


def _compute_mean(total: Floats, share: Floats) -> Floats:
    return total / np.maximum(share, np.float32(_LEAST_SHARE))


def _average_tiles(plane: Floats, scale: float) -> Floats:
    """Return means over tiles."""
    side = max(1, int(_TILE_PX * scale))
    height, width = plane.shape
    size = max(1, width // side), max(1, height // side)
    return average_areas(plane, size)


@dataclass(frozen=True, slots=True, eq=False)
class RefinementInputs:
    """The surface, features and images from which the refinement network's features are computed."""

    planes: Mapping[str, Floats]
    """(H, W) features by name, ``initial confidence`` among them."""
    surface: Surface
    consistency: PhotoConsistencyModel
    neighbourhood: Neighbourhood

    @classmethod
    def from_selection(
        cls,
        inputs: ConfidenceInputs,
        initial_features: Mapping[str, Floats],
        selection: Selection,
        doubtful: Pixels | None = None,
    ) -> RefinementInputs:
        """Return the inputs for a surface after candidate selection; see `compute_refined_features`."""
        prepared, keep = inputs.prepared, inputs.prepared.context.kernels.keep
        confidence = limit_confidence(selection.initial_confidence)
        consistency = PhotoConsistencyModel(prepared, selection.gain, inputs.buffers)
        planes = compute_refined_features(inputs, initial_features, confidence, consistency, doubtful)
        return cls(
            {name: keep(plane) for name, plane in planes.items()},
            inputs.surface,
            consistency,
            Neighbourhood.from_surface(inputs.surface.s, confidence, prepared),
        )

    @property
    def context(self) -> MatchContext:
        """Context of the frame."""
        return self.consistency.prepared.context

    def compute_features(self, pixels: Pixels, logit: Floats) -> dict[str, Floats]:
        """Return the features (1, N) by name of some pixels, whose confidence so far has the logits (N,)."""
        features = sample_planes(self.planes, pixels, self.context.kernels)
        features |= {"confidence": logit.astype(np.float32, copy=False)}
        slopes = self.surface.slope_u[pixels], self.surface.slope_v[pixels]
        features |= dict(zip(("slope u", "slope v"), slopes, strict=True))
        features |= self.neighbourhood.compute_image_features(pixels)
        features |= self.neighbourhood.compute_offset_features(pixels, self.surface.s[pixels], slopes)
        features |= self._shifted_consistency(pixels, slopes)
        return {name: values.reshape(1, -1) for name, values in features.items()}

    def _shifted_consistency(self, pixels: Pixels, slopes: tuple[Floats, Floats]) -> dict[str, Floats]:
        """Return (N,) by name: the photo-consistency if the pixels were shifted by `TRIED_PX`."""
        scale = np.float32(self.context.scale)
        shifted = self.surface.s[pixels] + scale * np.array(TRIED_PX, np.float32)[:, None]
        slope_u, slope_v = (np.broadcast_to(slope, shifted.shape) for slope in slopes)
        consistency = self.consistency.evaluate(pixels, shifted, (slope_u, slope_v))
        return {
            f"{name} {px:+g}": row
            for name, rows in compute_photo_consistency_features(
                consistency, len(self.consistency.prepared.images)
            )
            if name != "share of visible views"
            for px, row in zip(TRIED_PX, rows, strict=True)
        }


@dataclass(frozen=True, slots=True, eq=False)
class Neighbourhood:
    """The planes (H, W) whose values at neighbours are features."""

    s: Floats
    """Inverse depth of the surface."""
    initial_confidence: Floats
    """Logit."""
    log_level: NDArray[np.float32]
    """Logarithm of the core's level."""
    context: MatchContext

    @classmethod
    def from_surface(cls, s: Floats, initial_confidence: Floats, prepared: PreparedFrame) -> Neighbourhood:
        """Return the neighbourhood in a surface s, its initial confidence (H, W) and the core's levels."""
        log_level = np.log(np.maximum(prepared.filled_core, 0) + np.float32(_DARK))
        keep = prepared.context.kernels.keep
        return cls(keep(s), keep(initial_confidence), keep(log_level), prepared.context)

    @property
    def spacing(self) -> int:
        """Distance between neighbours, px."""
        return max(1, round(self.context.scale))

    def compute_image_features(self, pixels: Pixels) -> dict[str, Floats]:
        """Return (N,) by name: each neighbour's initial confidence and its brightness relative to the pixel's."""
        confidence, level = self._gather([self.initial_confidence, self.log_level], pixels)
        return _name("initial confidence", confidence) | _name(
            "relative brightness", level - self.log_level[pixels]
        )

    def compute_offset_features(
        self, pixels: Pixels, s: Floats, slopes: tuple[Floats, Floats]
    ) -> dict[str, Floats]:
        """Return (N,) by name: each neighbour's distance in front of the pixel's plane, px at scale 1."""
        (neighbour_s,) = self._gather([self.s], pixels)
        du, dv = self.spacing * _OFFSETS.T[..., None].astype(np.float32)
        plane = s + slopes[0] * du + slopes[1] * dv
        offset = fill_nan(neighbour_s - plane) * np.float32(1 / self.context.scale)
        return _name("offset", np.clip(offset, -_MOST_OFFSET_PX, _MOST_OFFSET_PX))

    def _gather(self, planes: Sequence[Floats], pixels: Pixels) -> Floats:
        return self.context.kernels.gather(planes, pixels[1], pixels[0], self.spacing * _OFFSETS, threads=1)


def sample_planes(planes: Mapping[str, Floats], pixels: Pixels, kernels: Kernels) -> dict[str, Floats]:
    """Return (N,) values of planes (H, W) at some pixels, by name."""
    values = kernels.gather(list(planes.values()), pixels[1], pixels[0], _CENTRE, threads=1)
    return dict(zip(planes, values.reshape(len(planes), -1), strict=True))


@cache
def _list_names(feature: str) -> tuple[str, ...]:
    return tuple(f"{feature} at {du:+d} {dv:+d}" for du, dv in _OFFSETS)


def _name(feature: str, rows: Floats) -> dict[str, Floats]:
    return dict(zip(_list_names(feature), rows, strict=True))
