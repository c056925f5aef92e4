"""Kernels of a frame's grey images: contrast, levels, sharpness and traces of demosaicing.

Images come as the cameras give them, of 8 or 16 bits; levels are in counts of 8 bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.arrays import demand_within, float32
from beltscape.kernels.backend import KernelFamily
from beltscape.kernels.resident import ResidentArray

MOST_BLUR_PX = 24
"""Largest radius of a blur's window, px (``kMostBlurRadius`` of sharpness.hpp)."""
_REACH = 4.0
"""Radius of a blur's window in sigmas of its Gaussian, as in OpenCV's of floats."""

GreyImage = NDArray[np.uint8 | np.uint16]


class ImageInput(NamedTuple):
    """Checked input of `measure_contrast`: an image (H, W) of 8 or of 16 bits."""

    bytes: NDArray[np.uint8] | None
    words: NDArray[np.uint16] | None

    @property
    def image(self) -> GreyImage:
        """The one of both that is there."""
        return cast("GreyImage", self.words if self.bytes is None else self.bytes)


class LevelsInput(NamedTuple):
    """Checked input of `make_levels`."""

    bytes: NDArray[np.uint8] | None
    words: NDArray[np.uint16] | None
    gain: Any
    """A number, or () on a GPU."""

    @property
    def image(self) -> GreyImage:
        """The one of both that is there."""
        return ImageInput(self.bytes, self.words).image


class SharpnessInput(NamedTuple):
    """Checked input of `measure_sharpness`."""

    image: NDArray[np.float32]
    """(H, W)"""
    weights: NDArray[np.float32]
    """(3, `MOST_BLUR_PX` + 1) of the three blurs, from the middle of the window outwards."""
    radii: NDArray[np.int32]
    """(3,) of the windows, px."""


class PhasesInput(NamedTuple):
    """Checked input of `measure_phases`."""

    image: NDArray[np.float32]
    """(H, W)"""


class PhotometryKernels(KernelFamily):
    """Kernels that prepare a frame's images for matching."""

    def measure_contrast(self, image: GreyImage) -> NDArray[np.float32]:
        """Return () the standard deviation of an image's levels (H, W), with the bits of NumPy's."""
        given = ImageInput(*_by_type(image))
        (found,) = self._run("measure_contrast", given, (np.empty(1, np.float32),), 1)
        return found.reshape(())

    def make_levels(self, image: GreyImage, gain: Any, *, threads: int = 1) -> NDArray[np.float32]:
        """Return the levels (H, W) of an image, in counts of 8 bits, times a gain: a number, or () on a GPU."""
        demand_within("gain", gain, 5e-324, np.inf)
        given = LevelsInput(*_by_type(image), gain)
        (found,) = self._run("make_levels", given, (np.empty(image.shape, np.float32),), threads)
        return found

    def measure_sharpness(
        self, image: NDArray[np.floating], sigmas_px: Sequence[float], *, threads: int = 1
    ) -> NDArray[np.float32]:
        """Return (2,) the variances of the differences of an image (H, W) that is blurred by three Gaussians.

        Beyond its edges the image is mirrored about the centres of its outermost pixels.

        Parameters
        ----------
        image
            (H, W) levels.
        sigmas_px
            Of the Gaussians, px, ascending and at most 6; 0 is none. The first difference is the first blur less the
            second, the other the second less the third.
        """
        if (
            len(sigmas_px) != 3
            or not 0 <= sigmas_px[0] <= sigmas_px[1] <= sigmas_px[2] <= MOST_BLUR_PX / _REACH
        ):
            raise KernelError(f"sigmas_px must be three from 0 to 6, ascending, not {list(sigmas_px)}")
        weights = np.zeros((3, MOST_BLUR_PX + 1), np.float32)
        radii = [choose_radius(sigma) for sigma in sigmas_px]
        for row, radius, sigma in zip(weights, radii, sigmas_px, strict=True):
            row[: radius + 1] = weigh_window(radius, sigma)
        given = SharpnessInput(float32("image", image, ("H", "W")), weights, np.array(radii, np.int32))
        (found,) = self._run("measure_sharpness", given, (np.empty(2, np.float32),), threads)
        return found

    def measure_phases(self, image: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return (4,) the mean absolute second difference of an image's pixels (H, W) over the four neighbours.

        Those of even rows and columns, of even rows and odd columns, of odd rows and even columns, and of odd ones.
        A last row or column without another is left out.
        """
        given = PhasesInput(float32("image", image, ("H", "W")))
        if min(given.image.shape) < 2:
            raise KernelError(f"image must be of at least 2 × 2 pixels, not {given.image.shape}")
        (found,) = self._run("measure_phases", given, (np.empty(4, np.float32),), 1)
        return found


def choose_radius(sigma_px: float) -> int:
    """Return the radius of a Gaussian's window, px: that of OpenCV's of floats; 0 without a blur."""
    return (round(2 * _REACH * sigma_px + 1) | 1) // 2 if sigma_px else 0


def weigh_window(radius: int, sigma_px: float) -> NDArray[np.float64]:
    """Return the weights (radius + 1,) of a Gaussian from the middle of its window outwards."""
    if radius == 0:
        return np.ones(1)
    weights = np.exp(-np.square(np.arange(radius + 1) / sigma_px) / 2)
    return np.asarray(weights / (2 * weights.sum() - 1), np.float64)


def measure_phases(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the means (4,) of an image's phases, where it is, see `PhotometryKernels.measure_phases`."""
    kernels = find_photometry_kernels(image)
    if kernels is None:
        from beltscape.kernels import opencv_planes  # imports OpenCV, which takes a while

        return opencv_planes.measure_phases(PhasesInput(image))[0]
    return kernels.measure_phases(image)


def find_photometry_kernels(image: Any) -> PhotometryKernels | None:
    """Return the kernels of the GPU on which an image is; None for one of the processor."""
    if isinstance(image, ResidentArray) and image.operations is not None:
        return PhotometryKernels(cast("Any", image.operations))
    return None


def _by_type(image: GreyImage) -> tuple[NDArray[np.uint8] | None, NDArray[np.uint16] | None]:
    """Return the image as one of 8 bits or as one of 16, or raise KernelError."""
    if image.ndim != 2 or not image.size or image.dtype not in (np.uint8, np.uint16):
        raise KernelError(f"image must be uint8 or uint16 (H, W), not {image.dtype} {image.shape}")
    whole: Any = image if isinstance(image, ResidentArray) else np.ascontiguousarray(image)
    return (whole, None) if image.dtype == np.uint8 else (None, whole)
