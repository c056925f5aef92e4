"""σ of depths if the lenses need not follow their models exactly.

A polynomial that fits the corners may still be wrong where no corner was: its σ there holds only if lenses are such
polynomials. So σ is computed with more radial terms than the model has, free within what lenses have; corners hold
these terms where the board was, and nothing else does.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.assessment.uncertainty.covariance import compute_formal_covariance
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.calibration.solver.bundle import Bundle
from beltscape.calibration.solver.lens import (
    compute_lens_prior,
    list_parameters,
    pad_rows,
    stack_intrinsics,
)
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.lens import MODELS
from beltscape.core.geometry.rig import Rig

Array = NDArray[np.float64]

GENERAL = {"brown": "rational"}
"""Lens model → the model that has its terms and more; the others are general enough, and limited to their corners."""


def compute_general_covariance(adjustment: BundleAdjustmentResult) -> tuple[Rig, Array]:
    """Return the rig with general lens models, at the adjusted values, and its formal covariance (G, G).

    Given lenses stay fixed.
    """
    cameras = {name: _generalise(camera) for name, camera in adjustment.rig.cameras.items()}
    rig, lenses = replace(adjustment.rig, cameras=cameras), stack_intrinsics(cameras.values())
    prior, geometry = adjustment.bundle.prior, replace(adjustment.geometry, intrinsics=lenses)
    is_free = np.any(prior.intrinsics_free, axis=1).tolist()
    free = [
        np.full(len(list_parameters(camera.model)), free)
        for camera, free in zip(cameras.values(), is_free, strict=True)
    ]
    general = replace(
        prior,
        models=tuple(camera.model for camera in cameras.values()),
        intrinsics=lenses,
        intrinsics_information=pad_rows(
            _extend_information(own, adjustment.rig.cameras[name], cameras[name])
            for own, name in zip(prior.intrinsics_information, cameras, strict=True)
        ),
        intrinsics_free=pad_rows(free),
    )
    bundle = Bundle(adjustment.bundle.observations, general, adjustment.bundle.weights)
    return rig, compute_formal_covariance(rig, bundle, bundle.linearise(geometry))


def _generalise(camera: Camera) -> Camera:
    model = GENERAL.get(camera.model, camera.model)
    added = len(MODELS[model].coefficients) - len(camera.distortion)
    return replace(camera, model=model, distortion=np.append(camera.distortion, np.zeros(added)))


def _extend_information(own: Array, camera: Camera, general: Camera) -> Array:
    """Return the information (W, W) of the adjustment's prior, with that of lenses for the added coefficients."""
    count = len(list_parameters(camera.model))
    information = compute_lens_prior(general)[1]
    information[:count, :count] = own[:count, :count]
    return information
