"""What the encoder says over what the material does: slip, or a wrong scale."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

_MEMORY_MM = 100_000.0
"""Travel after which older comparisons have faded to 1/e: a wheel wears, a scale may be mended."""
_UNTOLD = 0.005
"""One standard deviation of an encoder's scale before anything was compared."""


@dataclass(slots=True)
class EncoderScale:
    """Running comparison of encoder and material; bounded in memory, the same for the same steps."""

    _encoder_mm2: float = field(default=0.0)
    _both_mm2: float = field(default=0.0)
    _material_mm2: float = field(default=0.0)
    _weight: float = field(default=0.0)
    _count: int = field(default=0)

    def compare(self, encoder_mm: float, material_mm: float, sigma_mm: float) -> None:
        """One step of belt, as the encoder and as the material tell it."""
        fade = float(np.exp(-abs(material_mm) / _MEMORY_MM))
        weight = 1 / sigma_mm**2
        self._encoder_mm2 = fade * self._encoder_mm2 + weight * encoder_mm**2
        self._both_mm2 = fade * self._both_mm2 + weight * encoder_mm * material_mm
        self._material_mm2 = fade * self._material_mm2 + weight * material_mm**2
        self._weight = fade * self._weight + weight
        self._count += 1

    @property
    def compared(self) -> int:
        """Steps that were compared."""
        return self._count

    @property
    def ratio(self) -> float:
        """Encoder over material: above 1 the encoder says too much, or the material slips; 1 at first."""
        return self._encoder_mm2 / self._both_mm2 if self._both_mm2 > 0 else 1.0

    @property
    def scatter_mm(self) -> float:
        """Scatter of the single steps about the ratio; 0 for fewer than two."""
        if self._count < 2 or self._both_mm2 <= 0:
            return 0.0
        left = self._material_mm2 - self._both_mm2**2 / self._encoder_mm2
        return float(np.sqrt(max(left, 0.0) / self._weight * self._count / (self._count - 1)))

    @property
    def sigma(self) -> float:
        """One standard deviation of the ratio: from the material's σ, or the steps' scatter where that is larger."""
        if self._both_mm2 <= 0:
            return _UNTOLD
        claimed = 1 / np.sqrt(self._weight)
        number = max(1.0, self._encoder_mm2 / self._weight)  # mean square step, mm²
        scatter = self.scatter_mm / np.sqrt(self._count)
        return float(min(_UNTOLD, max(claimed, scatter) / np.sqrt(number)))
