"""Faults before a camera: dirt on its window, the lens cap, condensation, dust in the air, and defocus."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from beltscape.simulate.faults.base import Fault, GrowingFault, Pixels, Seed, Share

Light = NDArray[np.float32]
BlurPx = Annotated[float, Field(ge=0, le=200, allow_inf_nan=False)]

_PATCH = 0.15
"""Size of the patches of condensation as a share of the image's width; assumed."""


class Condensation(GrowingFault):
    """Droplets on a window: they blur the image and lay a veil over it, more in some places than in others."""

    camera: str
    blur_px: BlurPx = 4.0
    """σ of the blur where the droplets are densest."""
    veil: Share = 0.5
    """Share of the light that is spread over the whole image where they are densest."""
    coverage: Share = 0.7
    """Share of the image with droplets."""
    seed: Seed = 1

    def apply(self, light: Light, frame: int = 0) -> Light:
        """Return the light, (H, W) or (H, W, 3), behind the condensation."""
        extent = self.extent_at(frame)
        if extent == 0:
            return light
        shaped: Any = light if light.ndim == 3 else light[..., None]
        cover = self._cover(light.shape[:2], extent)[..., None]
        veiled = (1 - self.veil) * blur(shaped, self.blur_px) + self.veil * shaped.mean(axis=(0, 1))
        return np.asarray(shaped * (1 - cover) + veiled * cover, np.float32).reshape(light.shape)

    def _cover(self, shape: tuple[int, ...], extent: float) -> NDArray[np.float64]:
        """Return (H, W) the density of the droplets, 0..1."""
        noise = np.random.default_rng(self.seed).normal(size=shape)
        field = cv2.GaussianBlur(noise, (0, 0), _PATCH * shape[1] / 2, borderType=cv2.BORDER_REFLECT)
        if self.coverage * extent >= 1:
            return np.ones(shape)
        level, spread = np.quantile(field, 1 - self.coverage * extent), float(field.std())
        return np.clip(0.5 + (field - level) / max(spread, 1e-12), 0, 1)


class Dust(GrowingFault):
    """Dust in the air before one camera or all: less light from the belt, and a veil of scattered light."""

    camera: str = ""
    """Empty: every camera."""
    transmission: Share = 0.6
    """Share of the belt's light that arrives."""
    veil: Annotated[float, Field(ge=0, le=10)] = 0.3
    """Scattered light, as a multiple of the image's mean."""

    def apply(self, light: Light, frame: int = 0) -> Light:
        """Return the light behind the dust."""
        extent = self.extent_at(frame)
        loss, veil = extent * (1 - self.transmission), extent * self.veil
        return np.asarray(light * (1 - loss) + veil * light.mean(axis=(0, 1)), np.float32)


class Defocus(GrowingFault):
    """A camera out of focus."""

    camera: str
    sigma_px: BlurPx = 2.0
    """σ of the blur that is added."""

    def apply(self, light: Light, frame: int = 0) -> Light:
        """Return the blurred light."""
        sigma = self.sigma_px * self.extent_at(frame)
        return np.asarray(blur(light, sigma), np.float32).reshape(light.shape) if sigma > 0 else light


def blur(light: Any, sigma_px: float) -> Any:
    """Return light (H, W) or (H, W, C) blurred by a Gaussian."""
    if sigma_px <= 0:
        return light
    return cv2.GaussianBlur(light, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE).reshape(light.shape)


_SPECK = 0.02
"""Size of a speck as a share of the image's width; assumed: dust of 0.2 mm on a window some centimetres away."""
_STREAK = 8.0
"""Length of a smeared streak over its width; assumed: a wipe with a dry cloth."""
_SCATTER = 0.01
"""σ of the blur by a smeared film, as a share of the image's width; assumed."""


class Dirt(GrowingFault):
    """Dirt on a lens or its window: given specks, or random ones that cover a share of the image."""

    camera: str
    specks_px: tuple[tuple[Pixels, Pixels, Annotated[float, Field(gt=0, le=1e4)]], ...] = ()
    """Column, row and radius of given specks, far out of focus."""
    coverage: Share = 0.0
    """Share of the image under random specks, when the fault is complete."""
    shape: Literal["soft", "sharp", "smeared"] = "soft"
    """Random specks far out of focus, in focus, or wiped to streaks that also scatter the light."""
    opacity: Share = 0.6
    """Share of the light that the centre of a speck absorbs."""
    seed: Seed = 1
    """Of the random specks."""

    @model_validator(mode="after")
    def _check_specks(self) -> Dirt:
        if not self.specks_px and self.coverage == 0:
            raise ValueError("give specks_px, or a coverage above 0")
        return self

    def apply(self, light: Light, frame: int = 0) -> Light:
        """Return the light, (H, W) or (H, W, 3), behind the dirt."""
        extent = self.extent_at(frame)
        if extent == 0:
            return light
        shaped: Any = light if light.ndim == 3 else light[..., None]
        cover = self._cover_given(light.shape[:2], extent)[..., None]
        shaped = shaped * (1 - cover)
        if self.coverage > 0:
            cover = self._cover_random(light.shape[:2], extent)[..., None]
            behind = blur(shaped, _SCATTER * light.shape[1]) if self.shape == "smeared" else shaped
            shaped = shaped * (1 - cover) + behind * cover * (1 - self.opacity)
        return np.asarray(shaped, np.float32).reshape(light.shape)

    def _cover_given(self, shape: tuple[int, ...], extent: float) -> NDArray[np.float64]:
        """Return (H, W) the share of the light that the given specks absorb."""
        rows, columns = np.ogrid[: shape[0], : shape[1]]
        transmission = np.ones(shape)
        for column, row, radius in self.specks_px:
            distance = ((columns - column) ** 2 + (rows - row) ** 2) / (radius**2 * extent)
            transmission *= 1 - self.opacity * np.exp(-(distance**2))  # flat in the middle, soft at the rim
        return 1 - transmission

    def _cover_random(self, shape: tuple[int, ...], extent: float) -> NDArray[np.float64]:
        """Return (H, W) how far random specks cover each pixel, 0..1; a growing cover contains the earlier one."""
        size = max(1.0, _SPECK * shape[1])
        length = size * (_STREAK if self.shape == "smeared" else 1.0)
        noise = np.random.default_rng(self.seed).normal(size=shape)
        field = cv2.GaussianBlur(noise, (0, 0), length, sigmaY=size, borderType=cv2.BORDER_REFLECT)
        level = np.quantile(field, 1 - self.coverage * extent)
        cover = (field >= level).astype(np.float64)
        if self.shape == "sharp":
            return cover
        soft = cv2.GaussianBlur(cover, (0, 0), size / 2, borderType=cv2.BORDER_REPLICATE)
        return np.asarray(soft, np.float64)


class LensCap(Fault):
    """A lens cap, or anything opaque in front of a camera."""

    camera: str
    leak: Share = 0.0
    """Share of the light that still arrives."""

    def apply(self, light: Light, frame: int = 0) -> Light:
        """Return the light behind the cap."""
        return light * np.float32(self.leak) if self.is_active(frame) else light
