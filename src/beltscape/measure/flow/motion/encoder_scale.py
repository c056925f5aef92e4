"""The scale of the encoder relative to the material's motion: slip, or a wrong setting."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

_MEMORY_MM = 100_000.0
"""Travel after which older comparisons have decayed to 1/e: a wheel wears, a scale may be corrected."""
_PRIOR_SIGMA = 0.005
"""Prior standard deviation of an encoder's scale."""


@dataclass(slots=True)
class EncoderScale:
    """Running comparison of encoder and material, bounded in memory and deterministic."""

    _encoder_mm2: float = field(default=0.0)
    _both_mm2: float = field(default=0.0)
    _material_mm2: float = field(default=0.0)
    _weight: float = field(default=0.0)
    _count: int = field(default=0)

    def compare(self, encoder_mm: float, material_mm: float, sigma_mm: float) -> None:
        """Add one step of belt as measured by the encoder and by the material."""
        fade = float(np.exp(-abs(material_mm) / _MEMORY_MM))
        weight = 1 / sigma_mm**2
        self._encoder_mm2 = fade * self._encoder_mm2 + weight * encoder_mm**2
        self._both_mm2 = fade * self._both_mm2 + weight * encoder_mm * material_mm
        self._material_mm2 = fade * self._material_mm2 + weight * material_mm**2
        self._weight = fade * self._weight + weight
        self._count += 1

    @property
    def compared(self) -> int:
        """Return the number of compared steps."""
        return self._count

    @property
    def ratio(self) -> float:
        """Return encoder over material: above 1 the encoder reads too much, or the material slips; 1 at first."""
        return self._encoder_mm2 / self._both_mm2 if self._both_mm2 > 0 else 1.0

    @property
    def scatter_mm(self) -> float:
        """Return the scatter of the single steps about the ratio; 0 for fewer than two."""
        if self._count < 2 or self._both_mm2 <= 0:
            return 0.0
        left = self._material_mm2 - self._both_mm2**2 / self._encoder_mm2
        return float(np.sqrt(max(left, 0.0) / self._weight * self._count / (self._count - 1)))

    @property
    def sigma(self) -> float:
        """Return σ of the ratio: from the material's σ, or from the steps' scatter where that is larger."""
        if self._both_mm2 <= 0:
            return _PRIOR_SIGMA
        claimed = 1 / np.sqrt(self._weight)
        number = max(1.0, self._encoder_mm2 / self._weight)  # mean square step, mm²
        scatter = self.scatter_mm / np.sqrt(self._count)
        return float(min(_PRIOR_SIGMA, max(claimed, scatter) / np.sqrt(number)))
