"""Pictures of the loads of a material test, from an image or from the heights of the fused belt."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from beltscape.core.frames import to_grey
from beltscape.files.images import read_image
from beltscape.files.tiff import read_float_tiff
from beltscape.report.drawing.legend import HEIGHT, Rgb, Scale
from beltscape.report.drawing.pictures import Panel, quantile_range

_WIDTH_PX = 520
"""Width of a picture in a certificate: legible, at some 20 kB."""
_LONGEST = 4
"""Longest part of the belt that is shown, in widths."""
_LEAST_PX = 2
"""Least extent of a picture."""


@dataclass(frozen=True, slots=True, eq=False)
class LoadPicture:
    """A picture of a load."""

    load: str
    image: Rgb
    """(H, W, 3) uint8."""
    scale: Scale | None
    """Of heights in mm; None for an image of a camera."""
    name: str
    """Of its file."""
    sha256: str
    """Of its file."""

    @property
    def panel(self) -> Panel:
        """Return it with title and legend."""
        return Panel(self.image, self.load, self.scale, note=f"{self.name}, SHA-256 {self.sha256[:12]}…")


def read_load_picture(path: Path, load: str, sha256: str) -> LoadPicture:
    """Return the picture of a file: belt.tiff of `measure flow`, or an image; InputError if it cannot be read."""
    if path.name == "belt.tiff":
        height_mm = read_float_tiff(path).T  # along the belt to the right
        height_mm = height_mm[:, : _LONGEST * len(height_mm)]
        low, high = quantile_range(height_mm, 0.002)
        scale = Scale(min(low, 0.0), max(high, 1.0), HEIGHT, label="mm")
        return LoadPicture(load, _reduce(scale.to_rgb(height_mm)), scale, path.name, sha256)
    grey = to_grey(read_image(path)).astype(np.float32)
    top = max(float(np.quantile(grey, 0.995)), 1.0)
    tones = np.rint(255 * np.clip(grey / top, 0, 1) ** 0.6).astype(np.uint8)
    return LoadPicture(load, _reduce(np.repeat(tones[..., None], 3, axis=2)), None, path.name, sha256)


def _reduce(image: Rgb) -> Rgb:
    factor = _WIDTH_PX / image.shape[1]
    if factor >= 1:
        return image
    size = _WIDTH_PX, max(_LEAST_PX, round(factor * image.shape[0]))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
