"""Covariance of a rig by clusters of views, which does not take the corners of a view as independent.

Errors of the corners of one image are alike: blur, light, a detector's bias, a lens just outside its model. Then the
residuals fall, for poses and lenses follow the errors, while the rig scatters more. The covariance by clusters of
views (a sandwich; Bell & McCaffrey, Survey Methodology 28(2), 2002) takes each view's errors as they are: between the
inverse normal matrices stands the sum over the views of the squared influence of their own residuals, corrected by
(I − H)^−½ for what the view itself took from them. It assumes that different views are independent.
"""

from __future__ import annotations

import numpy as np

from beltscape.calibration.assessment.covariance import place_covariance
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.calibration.solver.bundle import ViewDesign
from beltscape.calibration.solver.levenberg_marquardt import single_thread
from beltscape.core.arrays import Array

MIN_REMAINING = 1e-3
"""Least share of a view's own variance that counts as left by the adjustment: combinations of its corners that
determine its board's pose alone have no residual, and their correction would be endless."""


def compute_clustered_covariance(adjustment: BundleAdjustmentResult) -> Array:
    """Return the covariance (G, G) of the rig's parameters by clusters of views; 0 for fixed ones."""
    bundle, total = adjustment.bundle, np.zeros((len(adjustment.bundle.free), len(adjustment.bundle.free)))
    with single_thread():
        linear = bundle.linearise(adjustment.geometry)
        inverse, (boards, responses) = linear.covariance(), linear.invert_boards()
        for view in bundle.list_view_designs(adjustment.geometry):
            change = _compute_influence(view, inverse, boards[view.frame], responses[view.frame])
            total += np.outer(change, change)
    return place_covariance(adjustment.rig, bundle, total)


def _compute_influence(view: ViewDesign, inverse: Array, board: Array, response: Array) -> Array:
    """Return the change (G,) of the shared parameters by the errors of a view, as far as its residuals show them."""
    eliminated = view.by_shared - view.by_board @ response
    gain = eliminated @ inverse
    hat = gain @ eliminated.T + view.by_board @ board @ view.by_board.T
    values, vectors = np.linalg.eigh(np.eye(len(hat)) - hat)
    roots = np.sqrt(np.maximum(values, MIN_REMAINING))
    return np.asarray(gain.T @ (vectors @ ((vectors.T @ view.residuals) / roots)), np.float64)
