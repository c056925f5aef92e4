"""Where the surface is: near and far from the rig's geometry and a coarse look, without being told."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.camera import Camera
from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet, Image
from beltscape.core.progress import Reporter
from beltscape.core.rig import Rig
from beltscape.stereo.contrast import square_root
from beltscape.stereo.fusion import fuse
from beltscape.stereo.settings import PairwiseSettings
from beltscape.stereo.sgbm import pair_matcher
from beltscape.stereo.views import usable_auxiliaries

COARSE_WIDTH_PX = 400
"""The coarse look halves the images until they would become narrower than this."""
_PARALLEL_RAD = np.deg2rad(3.0)
"""Optical axes closer to parallel than this do not say where the surface is."""
_AROUND_CONVERGENCE = (0.45, 2.2)
"""Where a surface may lie, in units of the depth at which the axes meet."""
_BASELINES = (1.2, 40.0)
"""Where a surface may lie, in baselines, when the axes are parallel."""
_ENDS = (0.0005, 0.9995)
"""Share of the trusted pixels that may lie nearer, and beyond: stray matches."""
_MARGIN = (0.06, 0.03)
"""Kept free before and behind what the coarse look saw, as a share of the depth: small tall things it missed."""
_ENOUGH_PX = 200


def find_depth_range(
    rig: Rig, frame_set: FrameSet, settings: PairwiseSettings, reporter: Reporter
) -> tuple[float, float]:
    """Near and far end of what is seen, along the core's optical axis, mm.

    Where the optical axes meet (or, for a parallel rig, how long the baselines are) bounds a coarse matching of
    all pairs; what several pairs agree on gives the range, with margins.

    Raises
    ------
    ReconstructionError
        When no pair is left, or the coarse look finds no surface.
    """
    names = usable_auxiliaries(rig, frame_set)
    wide = search_range(rig, names)
    plain = settings.model_copy(update={"oversampling": 1.0})
    halvings = max(0, int(np.log2(rig.core_camera.size_px[0] / COARSE_WIDTH_PX)))
    coarse_rig = scaled_rig(rig, halvings)
    roots = {name: square_root(_halved(frame_set.images[name], halvings)) for name in (rig.core, *names)}

    def look(name: str) -> NDArray[np.float32] | None:
        try:
            matcher = pair_matcher(coarse_rig, name, wide, plain)
        except ReconstructionError as error:
            reporter.warn(f"{error}; going on without this pair")
            return None
        return matcher.depth(roots[rig.core], roots[name])

    with ThreadPoolExecutor(settings.threads or os.cpu_count() or 1) as pool:
        depths = [depth for depth in pool.map(look, names) if depth is not None]
    if not depths:
        raise ReconstructionError(f"frame {frame_set.frame}: no pair of cameras has a common view")
    trusted = _trusted(np.stack(depths), coarse_rig, names)
    if len(trusted) < _ENOUGH_PX:
        raise ReconstructionError(
            f"frame {frame_set.frame}: no surface found between {wide[0]:.0f} and {wide[1]:.0f} mm; is the "
            "speckle projector on? Or give the depth range"
        )
    near, far = np.quantile(trusted, _ENDS)
    return max(wide[0], float(near) * (1 - _MARGIN[0])), float(far) * (1 + _MARGIN[1])


def search_range(rig: Rig, auxiliaries: tuple[str, ...]) -> tuple[float, float]:
    """(near, far) in mm within which any surface this rig was built for must lie."""
    meeting = [depth for name in auxiliaries if (depth := _convergence_mm(rig, name)) is not None]
    if meeting:
        middle = float(np.median(meeting))
        return middle * _AROUND_CONVERGENCE[0], middle * _AROUND_CONVERGENCE[1]
    baseline = max(float(np.linalg.norm(rig.cam_from_core[name].center_mm)) for name in auxiliaries)
    return baseline * _BASELINES[0], baseline * _BASELINES[1]


def scaled_rig(rig: Rig, halvings: int) -> Rig:
    """The same rig with images averaged 2×2 ``halvings`` times."""
    return replace(rig, cameras={name: _scaled(camera, halvings) for name, camera in rig.cameras.items()})


def _scaled(camera: Camera, halvings: int) -> Camera:
    factor = 2**halvings
    return replace(
        camera,
        size_px=(camera.size_px[0] // factor, camera.size_px[1] // factor),
        focal_px=camera.focal_px / factor,
        center_px=(camera.center_px + 0.5) / factor - 0.5,
    )


def _halved(image: Image, halvings: int) -> Image:
    factor = 2**halvings
    height, width = (n // factor for n in image.shape[:2])
    whole = image[: height * factor, : width * factor]
    return cast(Image, cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA))


def _convergence_mm(rig: Rig, name: str) -> float | None:
    """Depth at which the core's axis is closest to the auxiliary's; None for parallel or parting axes."""
    pose = rig.cam_from_core[name].inverse()
    axis = pose.rotation[:, 2]
    sine2 = 1.0 - axis[2] ** 2
    if sine2 < np.sin(_PARALLEL_RAD) ** 2:
        return None
    across = pose.translation_mm - np.dot(pose.translation_mm, axis) * axis
    depth = float(across[2] / sine2)
    return depth if depth > 0 else None


def _trusted(depths_mm: NDArray[np.float32], rig: Rig, names: tuple[str, ...]) -> NDArray[np.float32]:
    """Depths on which at least two pairs agree within a pixel or two; of a single pair all there are."""
    if len(depths_mm) == 1:
        return depths_mm[np.isfinite(depths_mm)]
    baseline = np.mean([np.linalg.norm(rig.cam_from_core[name].center_mm) for name in names])
    fused = fuse(depths_mm, 1.5 / float(np.mean(rig.core_camera.focal_px) * baseline))
    return fused.depth_mm[fused.views >= 2]
