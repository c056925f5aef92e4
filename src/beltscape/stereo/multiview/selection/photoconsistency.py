"""Photo-consistency of surfaces: differences between the core's levels and the auxiliaries', after the gain."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.selection.candidates import PhotoConsistency
from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.frame.parallel import Pixels
from beltscape.stereo.multiview.frame.surface import OCCLUDER_PX, Surface
from beltscape.stereo.multiview.selection.gain import PhotometricGain

Array = NDArray[np.floating]

PHOTOMETRIC_LIMIT = 3.5
"""Initial confidence (logit) from which on the photo-consistency of a surface is not evaluated."""
_LOG_OFFSET = 0.1
"""Added to differences before the logarithm; smaller differences are equal."""


@dataclass(frozen=True, slots=True, eq=False)
class PhotoConsistencyModel:
    """Images, gain and occluders with which surfaces are compared."""

    prepared: PreparedFrame
    gain: PhotometricGain
    buffers: Sequence[Array]
    """n of (h, w): inverse-depth buffers of the occluders in each auxiliary."""

    def evaluate(
        self, pixels: Pixels, s: Array, slopes: tuple[Array, Array], threads: int = 1
    ) -> PhotoConsistency:
        """Return the photo-consistency of n surfaces with s and slopes (n, N) at each of N pixels."""
        prepared = self.prepared
        return prepared.context.kernels.photo_consistency(
            pixels[1], pixels[0], s, *slopes, core=prepared.core, variance=self.gain.variance,
            images=prepared.images, views=prepared.views, buffers=self.buffers, gains=self.gain.gains,
            tolerance=OCCLUDER_PX, threads=threads,
        )  # fmt: skip


def compute_photo_consistency_features(
    consistency: PhotoConsistency, auxiliaries: int
) -> Iterator[tuple[str, Array]]:
    """Yield features by name: logarithms of the differences, and the visible views, also as a share."""
    for name, plane in zip(PhotoConsistency._fields[:-1], consistency[:-1], strict=True):
        offset = plane + np.float32(_LOG_OFFSET)
        yield name.replace("_", " "), np.log(offset, out=offset)
    yield "visible views", np.minimum(consistency.views, 4)
    yield "share of visible views", consistency.views / np.float32(auxiliaries)


def compute_photometric_features(
    surface: Surface, initial_confidence: Array, consistency: PhotoConsistencyModel
) -> Iterator[tuple[str, Array]]:
    """Yield the photo-consistency (H, W) by name, evaluated below `PHOTOMETRIC_LIMIT`.

    The other pixels count as consistent and visible in no view.
    """
    prepared = consistency.prepared
    auxiliaries = len(prepared.images)
    places = np.flatnonzero(initial_confidence < PHOTOMETRIC_LIMIT)
    if not len(places):
        places = np.zeros(1, int)
    planes = surface.s, surface.slope_u, surface.slope_v
    s, slope_u, slope_v = (plane.ravel()[places][None] for plane in planes)
    pixels = np.unravel_index(places, surface.s.shape)
    evaluated = consistency.evaluate(pixels, s, (slope_u, slope_v), prepared.context.threads)
    consistent = PhotoConsistency(*(np.zeros((1, 1), np.float32) for _ in evaluated))
    elsewhere = dict(compute_photo_consistency_features(consistent, auxiliaries))
    for name, values in compute_photo_consistency_features(evaluated, auxiliaries):
        plane = np.full(surface.s.shape, elsewhere[name].item(), np.float32)
        plane.ravel()[places] = values[0]
        yield name, plane
