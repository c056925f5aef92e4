"""All dimensions of a module in one depth map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arguments import require_depth_of
from beltscape.core.depth import DepthMap
from beltscape.core.errors import MeasureError
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.measure.features.edges import EdgeScene, Extent, measure_circle, measure_rectangle
from beltscape.measure.features.face import Face, estimate_correlation_area_px, fit_face
from beltscape.measure.features.pose import find_module, refine_pose
from beltscape.measure.features.result import EdgeLine, MeasuredDimension, MeasuredModule
from beltscape.measure.features.smoothing import compute_camera_scale, estimate_smoothing
from beltscape.measure.features.solids import NominalView, render_nominal_view
from beltscape.measure.features.sphere import FittedSphere, fit_sphere
from beltscape.target.module import Cube, Cylinder, Module, Sphere

_MIN_FOUND = 0.5
"""With a smaller share of its features found, the object is not this module."""
_FLAT_MM = 0.0005
"""Slow errors of a face that the scatter about its plane does not contain, at the paper's size of images, halved.
They grow with the cube of the pixel size (simulated heights: 0.001 mm at 1224, 0.008 mm at 612 px)."""


@dataclass(frozen=True, slots=True)
class FaceErrors:
    """Errors of faces that the scatter of independent pixels does not contain."""

    area_px: float
    """Number of pixels whose errors act as one (correlation area)."""
    flat_mm: float
    """Standard deviation of the slow errors of a face."""


def measure_module(
    depth: DepthMap,
    rig: Rig,
    module: Module,
    *,
    pattern: NDArray[np.float32] | None = None,
    plain: NDArray[np.float32] | None = None,
) -> MeasuredModule:
    """Find the module and measure its features independently of each other.

    Parameters
    ----------
    depth
        Depth map on the core camera's undistorted grid.
    rig
        Rig with which the depth map was computed.
    module
        Nominal dimensions, used as search regions and not as results.
    pattern
        (H, W) brightness of the matched image, on the same grid: for edges and spheres.
    plain
        (H, W) brightness of the same static scene without the pattern: for edges.

    Raises
    ------
    MeasureError
        if the module is not found, or its base cannot be measured.
    """
    camera = rig.core_camera
    require_depth_of(camera, depth, "module")
    match = find_module(depth, camera, module)
    pose = refine_pose(depth, camera, module, match.core_from_module)
    view = render_nominal_view(module, pose, camera)
    faces = _fit_faces(depth, rig, module, view)
    if "base" not in faces:
        raise MeasureError(f"{module.name}: too little of its base is measured; heights need it")
    image = plain if plain is not None else pattern  # without dots, edges are clearer
    scene = EdgeScene(camera, depth.depth_mm, image, view, pose)
    errors = FaceErrors(
        estimate_correlation_area_px([face.residual_mm for face in faces.values()]),
        _FLAT_MM / compute_camera_scale(camera) ** 3,
    )
    spheres = _fit_spheres(depth, rig, module, view, pose, pattern)
    quantities, edges = _measure_quantities(scene, module, faces, spheres, errors)
    _require_features(module, len(spheres) + len(faces) - 1)
    quantities += _measure_steps(module, faces, errors)
    # a systematic error of all pixels changes every dimension by up to its size, one of scale by a share
    quantities = [
        replace(one, sigma_mm=float(np.sqrt(one.sigma_mm**2 + depth.systematic_mm**2 + scale_mm**2)))
        for one in quantities
        for scale_mm in (rig.scale_sigma * one.measured_mm,)
    ]
    warnings = _collect_warnings(module, quantities, edges, pattern is not None)
    return MeasuredModule(
        module, pose, match.agreement, view, faces, spheres, tuple(edges), tuple(quantities), warnings
    )


def _measure_quantities(
    scene: EdgeScene,
    module: Module,
    faces: dict[str, Face],
    spheres: dict[str, FittedSphere],
    errors: FaceErrors,
) -> tuple[list[MeasuredDimension], list[EdgeLine]]:
    """Measure the base and every feature; return their quantities and the edges they were measured by."""
    quantities, edges = _measure_base(scene, module, faces["base"])
    for label, feature in enumerate(module.features, start=1):
        top = faces.get(feature.name)
        if isinstance(feature, Sphere):
            quantities.append(_make_radius(feature, spheres.get(feature.name)))
            continue
        if isinstance(feature, Cube):
            width, lines = _measure_edge(scene, feature, label, top)
        else:
            width, lines = _measure_diameter(scene, feature, label, top)
        quantities += [width, _measure_height(feature, top, faces["base"], errors)]
        edges += lines
    return quantities, edges


def _require_features(module: Module, found: int) -> None:
    """Refuse an object with a base of the same size and other features."""
    if found < _MIN_FOUND * len(module.features):
        raise MeasureError(
            f"{module.name}: only {found} of its {len(module.features)} features are where they should be; "
            "is this its module.toml, and is it within view?"
        )


def _fit_faces(depth: DepthMap, rig: Rig, module: Module, view: NominalView) -> dict[str, Face]:
    """Return the flat upper faces that can be measured, by name."""
    labels = {"base": 0} | {
        feature.name: label
        for label, feature in enumerate(module.features, start=1)
        if not isinstance(feature, Sphere)
    }
    found = {
        name: fit_face(depth, rig.core_camera, view.face(label), view.depth_mm)
        for name, label in labels.items()
    }
    return {name: face for name, face in found.items() if face is not None}


def _fit_spheres(
    depth: DepthMap,
    rig: Rig,
    module: Module,
    view: NominalView,
    pose: Pose,
    pattern: NDArray[np.float32] | None,
) -> dict[str, FittedSphere]:
    """Return the spheres that can be measured, by name."""
    smoothing = None if pattern is None else estimate_smoothing(pattern, depth, rig)
    spheres: dict[str, FittedSphere] = {}
    for label, feature in enumerate(module.features, start=1):
        if not isinstance(feature, Sphere):
            continue
        radius = feature.diameter_mm / 2
        center = pose.apply(np.array([*feature.center_mm, radius], dtype=np.float64))
        fitted = fit_sphere(depth, rig.core_camera, view.face(label), center, radius, smoothing)
        if fitted:
            spheres[feature.name] = fitted
    return spheres


def _measure_base(
    scene: EdgeScene, module: Module, face: Face
) -> tuple[list[MeasuredDimension], list[EdgeLine]]:
    length, width, _ = module.base.size_mm
    extents, lines = measure_rectangle(scene, "base", 0, face, np.zeros(3), (length, width))
    named = zip(("length", "width"), (length, width), extents, strict=True)
    return [_make_quantity("base", quantity, nominal, extent) for quantity, nominal, extent in named], lines


def _measure_edge(
    scene: EdgeScene, cube: Cube, label: int, face: Face | None
) -> tuple[MeasuredDimension, list[EdgeLine]]:
    """Measure the mean of the upper face's two edge lengths."""
    if face is None:
        return _make_quantity(cube.name, "edge", cube.edge_mm, None), []
    place = np.array([*cube.center_mm, cube.edge_mm])
    (x, y), lines = measure_rectangle(scene, cube.name, label, face, place, (cube.edge_mm, cube.edge_mm))
    extents = [extent for extent in (x, y) if extent]
    if not extents:
        return _make_quantity(cube.name, "edge", cube.edge_mm, None), lines
    sigma = float(np.sqrt(sum(extent.sigma_mm**2 for extent in extents)) / len(extents))
    mean = sum(extent.length_mm for extent in extents) / len(extents)
    extent = Extent(mean, sigma, sum(extent.points for extent in extents))
    return _make_quantity(cube.name, "edge", cube.edge_mm, extent), lines


def _measure_diameter(
    scene: EdgeScene, rod: Cylinder, label: int, face: Face | None
) -> tuple[MeasuredDimension, list[EdgeLine]]:
    if face is None:
        return _make_quantity(rod.name, "diameter", rod.diameter_mm, None), []
    place = np.array([*rod.center_mm, rod.height_mm])
    extent, lines = measure_circle(scene, rod.name, label, face, place, rod.diameter_mm)
    return _make_quantity(rod.name, "diameter", rod.diameter_mm, extent), lines


def _make_quantity(name: str, quantity: str, nominal_mm: float, extent: Extent | None) -> MeasuredDimension:
    if extent is None:
        return MeasuredDimension(name, quantity, nominal_mm, float("nan"), float("nan"), 0)
    return MeasuredDimension(name, quantity, nominal_mm, extent.length_mm, extent.sigma_mm, extent.points)


def _make_radius(sphere: Sphere, fitted: FittedSphere | None) -> MeasuredDimension:
    extent = None if fitted is None else Extent(fitted.radius_mm, fitted.sigma_mm, fitted.points)
    return _make_quantity(sphere.name, "radius", sphere.diameter_mm / 2, extent)


def _measure_height(
    feature: Cube | Cylinder, top: Face | None, base: Face, errors: FaceErrors
) -> MeasuredDimension:
    """Measure the height of the upper face's centre over the base's plane."""
    nominal = feature.edge_mm if isinstance(feature, Cube) else feature.height_mm
    if top is None:
        return _make_quantity(feature.name, "height", nominal, None)
    height, slope = base.height_above(top.middle_mm)
    variance = top.depth_variance(errors.area_px) + errors.area_px * float(slope @ base.covariance @ slope)
    variance += 2 * errors.flat_mm**2
    return _make_quantity(
        feature.name, "height", nominal, Extent(height, float(np.sqrt(variance)), top.points)
    )


def _measure_steps(module: Module, faces: dict[str, Face], errors: FaceErrors) -> list[MeasuredDimension]:
    """Measure the height differences of cubes next in size, in which most of the base's error cancels."""
    base = faces["base"]
    steps: list[MeasuredDimension] = []
    cubes = sorted(module.cube, key=lambda cube: -cube.edge_mm)
    for large, small in pairwise(cubes):
        upper, lower = faces.get(large.name), faces.get(small.name)
        extent = None
        if upper and lower:
            (high, slope), (low, other) = (
                base.height_above(upper.middle_mm),
                base.height_above(lower.middle_mm),
            )
            variance = upper.depth_variance(errors.area_px) + lower.depth_variance(errors.area_px)
            variance += 2 * errors.flat_mm**2 + errors.area_px * float(
                (slope - other) @ base.covariance @ (slope - other)
            )
            extent = Extent(high - low, float(np.sqrt(variance)), upper.points + lower.points)
        name = f"step:{large.name}-{small.name}"
        steps.append(_make_quantity(name, "height_difference", large.edge_mm - small.edge_mm, extent))
    return steps


def _collect_warnings(
    module: Module, quantities: Sequence[MeasuredDimension], edges: Sequence[EdgeLine], patterned: bool
) -> tuple[str, ...]:
    names = [feature.name for feature in module.features]
    missing = [q for q in quantities if np.isnan(q.measured_mm)]
    unmeasured = [n for n in names if all(q in missing for q in quantities if q.name == n)]
    warnings = [
        f"{name}: not measured; it is missing, hidden, or not where module.toml has it" for name in unmeasured
    ]
    warnings += [
        f"{q.name}: {q.quantity} not measured; too little of it is seen"
        for q in missing
        if q.name not in unmeasured
    ]
    if not patterned:
        warnings.append(
            "the frame has no image.png: spheres are not corrected for the matcher's smoothing; reconstruct again"
        )
    by_rim = sorted({edge.name for edge in edges if not edge.by_image})
    if by_rim:
        warnings.append(f"{', '.join(by_rim)}: edges by the depth map's rim alone, to about a pixel")
    return tuple(warnings)
