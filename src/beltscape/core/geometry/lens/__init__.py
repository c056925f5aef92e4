"""Lens models by name: Brown's polynomial, OpenCV's rational, thin-prism and tilted models, and the fisheye model.

`model.LensModel` gives distortion and derivatives, `domain` the radius up to which a model is valid. Every Python
module that needs a lens calls these; `native/lens.hpp` holds them once more for the kernels.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from beltscape.core.geometry.lens.model import LensModel
from beltscape.core.geometry.lens.radial import Fisheye, Polynomial, Rational

_BROWN = ("k1", "k2", "p1", "p2", "k3")
_RATIONAL = (*_BROWN, "k4", "k5", "k6")
_PRISM = (*_RATIONAL, "s1", "s2", "s3", "s4")

BROWN = LensModel("brown", _BROWN, Polynomial())
RATIONAL = LensModel("rational", _RATIONAL, Rational())
THIN_PRISM = LensModel("thin_prism", _PRISM, Rational())
TILTED = LensModel("tilted", (*_PRISM, "tau_x", "tau_y"), Rational())
FISHEYE = LensModel("fisheye", ("k1", "k2", "k3", "k4"), Fisheye())

MODELS: Mapping[str, LensModel] = MappingProxyType(
    {model.name: model for model in (BROWN, RATIONAL, THIN_PRISM, TILTED, FISHEYE)}
)
"""All lens models by name, from few to many coefficients, the fisheye last."""


def list_intrinsics(model: str) -> tuple[str, ...]:
    """Return the names, with units, of the intrinsics of a camera with a lens model, as in rig.json's covariance."""
    coefficients = (f"{name}_rad" if name[0] == "t" else name for name in MODELS[model].coefficients)
    return ("fx_px", "fy_px", "cx_px", "cy_px", *coefficients)
