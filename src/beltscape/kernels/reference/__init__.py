"""The kernels in plain NumPy, float64: what the fast ones are held against. Written to be read, a family a file."""

from __future__ import annotations

from beltscape.kernels.reference.aggregation import aggregate
from beltscape.kernels.reference.coarse import coarse
from beltscape.kernels.reference.first_met import first_met
from beltscape.kernels.reference.hear import hear
from beltscape.kernels.reference.local_fit import local_fit
from beltscape.kernels.reference.neighbours import neighbours
from beltscape.kernels.reference.normal_equations import normal_equations
from beltscape.kernels.reference.occlusion import nearness_buffers, visible
from beltscape.kernels.reference.perceptron import perceptron
from beltscape.kernels.reference.propagation import propagate
from beltscape.kernels.reference.quadratics import quadratics
from beltscape.kernels.reference.rivals import likenesses, rivals
from beltscape.kernels.reference.sweep import sweep
from beltscape.kernels.reference.top_view import top_view
from beltscape.kernels.reference.triangulation import triangulate
from beltscape.kernels.reference.warping import spline_coefficients, warp
from beltscape.kernels.reference.windows import plane_slopes, window_means, window_minima


class ReferenceKernels:
    """Every kernel, one obvious step after another."""

    name = "reference"
    triangulate = staticmethod(triangulate)
    spline_coefficients = staticmethod(spline_coefficients)
    warp = staticmethod(warp)
    nearness_buffers = staticmethod(nearness_buffers)
    visible = staticmethod(visible)
    sweep = staticmethod(sweep)
    aggregate = staticmethod(aggregate)
    coarse = staticmethod(coarse)
    normal_equations = staticmethod(normal_equations)
    local_fit = staticmethod(local_fit)
    propagate = staticmethod(propagate)
    perceptron = staticmethod(perceptron)
    hear = staticmethod(hear)
    rivals = staticmethod(rivals)
    likenesses = staticmethod(likenesses)
    neighbours = staticmethod(neighbours)
    top_view = staticmethod(top_view)
    first_met = staticmethod(first_met)
    quadratics = staticmethod(quadratics)
    window_means = staticmethod(window_means)
    window_minima = staticmethod(window_minima)
    plane_slopes = staticmethod(plane_slopes)
