"""The kernels in plain NumPy, float64: what the fast ones are held against. Written to be read, a family a file."""

from __future__ import annotations

from beltscape.kernels.reference.triangulation import triangulate


class ReferenceKernels:
    """Every kernel, one obvious step after another."""

    name = "reference"
    triangulate = staticmethod(triangulate)
