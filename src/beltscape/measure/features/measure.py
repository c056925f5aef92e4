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
from beltscape.core.pose import Pose
from beltscape.core.rig import Rig
from beltscape.measure.features.edges.outline import Extent, Scene, circle, rectangle
from beltscape.measure.features.face import Face, fit_face
from beltscape.measure.features.grain import grain_px
from beltscape.measure.features.pose.find import find_module
from beltscape.measure.features.pose.nominal import NominalView, nominal_view
from beltscape.measure.features.pose.refine_pose import settle
from beltscape.measure.features.result import EdgeLine, MeasuredModule, Quantity
from beltscape.measure.features.smoothing import smoothing_of
from beltscape.measure.features.sphere import Ball, fit_sphere
from beltscape.measure.features.view import scale_of
from beltscape.target.module import Cube, Cylinder, Module, Sphere

_LEAST_FOUND = 0.5
"""With fewer of its features it is not this module."""
_FLAT_MM = 0.0005
"""What no face of a depth map is better than at the paper's size of images, halved: slow errors that a plane's own
scatter does not show. They grow as pixels do, cubed (simulated heights: 0.001 mm at 1224, 0.008 mm at 612 px)."""


@dataclass(frozen=True, slots=True)
class FaceErrors:
    """What the scatter of a face's pixels alone does not show."""

    area_px: float
    """Pixels that err as one."""
    flat_mm: float
    """Slow errors of a face."""


def measure_module(
    depth: DepthMap,
    rig: Rig,
    module: Module,
    *,
    pattern: NDArray[np.float32] | None = None,
    plain: NDArray[np.float32] | None = None,
) -> MeasuredModule:
    """Find the module and measure its features, each by itself.

    Parameters
    ----------
    depth
        On the core camera's undistorted grid.
    rig
        That it was made with.
    module
        The nominal dimensions; they tell where to look, not what comes out.
    pattern
        (H, W) brightness of the image the depth was matched by, on the same grid: for edges and spheres.
    plain
        (H, W) of the same still scene without the pattern: for edges.

    Raises
    ------
    MeasureError
        When the module is not to be found, or its base not to be measured.
    """
    camera = rig.core_camera
    require_depth_of(camera, depth, "module")
    match = find_module(depth, camera, module)
    pose = settle(depth, camera, module, match.core_from_module)
    view = nominal_view(module, pose, camera)
    faces = _faces(depth, rig, module, view)
    if "base" not in faces:
        raise MeasureError(f"{module.name}: too little of its base is measured; heights need it")
    image = plain if plain is not None else pattern  # dots only disturb what a plain image shows
    scene = Scene(camera, depth.depth_mm, image, view, pose)
    errors = FaceErrors(
        grain_px([face.residual_mm for face in faces.values()]), _FLAT_MM / scale_of(camera) ** 3
    )
    balls = _balls(depth, rig, module, view, pose, pattern)
    quantities, edges = _base(scene, module, faces["base"])
    for label, feature in enumerate(module.features, start=1):
        top = faces.get(feature.name)
        if isinstance(feature, Sphere):
            quantities.append(_radius(feature, balls.get(feature.name)))
            continue
        if isinstance(feature, Cube):
            found, lines = _edge(scene, feature, label, top)
        else:
            found, lines = _diameter(scene, feature, label, top)
        quantities += [found, _height(feature, top, faces["base"], errors)]
        edges += lines
    _check(module, len(balls) + len(faces) - 1)
    quantities += _steps(module, faces, errors)
    # an error that all pixels share moves every dimension by up to itself
    quantities = [
        replace(one, sigma_mm=float(np.hypot(one.sigma_mm, depth.systematic_mm))) for one in quantities
    ]
    warnings = _warnings(module, quantities, edges, pattern is not None)
    return MeasuredModule(
        module, pose, match.agreement, view, faces, balls, tuple(edges), tuple(quantities), warnings
    )


def _check(module: Module, found: int) -> None:
    """Refuse a plate of the same size with other things on it."""
    if found < _LEAST_FOUND * len(module.features):
        raise MeasureError(
            f"{module.name}: only {found} of its {len(module.features)} features are where they should be; "
            "is this its module.toml, and is it within view?"
        )


def _faces(depth: DepthMap, rig: Rig, module: Module, view: NominalView) -> dict[str, Face]:
    """The flat upper faces that can be measured, by name."""
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


def _balls(
    depth: DepthMap,
    rig: Rig,
    module: Module,
    view: NominalView,
    pose: Pose,
    pattern: NDArray[np.float32] | None,
) -> dict[str, Ball]:
    """Return the spheres that can be measured, by name."""
    smoothing, balls = None if pattern is None else smoothing_of(pattern, depth, rig), {}
    for label, feature in enumerate(module.features, start=1):
        if not isinstance(feature, Sphere):
            continue
        radius = feature.diameter_mm / 2
        center = pose.apply(np.array([*feature.center_mm, radius], dtype=np.float64))
        ball = fit_sphere(depth, rig.core_camera, view.face(label), center, radius, smoothing)
        if ball:
            balls[feature.name] = ball
    return balls


def _base(scene: Scene, module: Module, face: Face) -> tuple[list[Quantity], list[EdgeLine]]:
    length, width, _ = module.base.size_mm
    extents, lines = rectangle(scene, "base", 0, face, np.zeros(3), (length, width))
    named = zip(("length", "width"), (length, width), extents, strict=True)
    return [_quantity("base", quantity, nominal, extent) for quantity, nominal, extent in named], lines


def _edge(scene: Scene, cube: Cube, label: int, face: Face | None) -> tuple[Quantity, list[EdgeLine]]:
    """The mean of the top's two edge lengths."""
    if face is None:
        return _quantity(cube.name, "edge", cube.edge_mm, None), []
    place = np.array([*cube.center_mm, cube.edge_mm])
    (x, y), lines = rectangle(scene, cube.name, label, face, place, (cube.edge_mm, cube.edge_mm))
    both = [extent for extent in (x, y) if extent]
    if not both:
        return _quantity(cube.name, "edge", cube.edge_mm, None), lines
    sigma = float(np.sqrt(sum(extent.sigma_mm**2 for extent in both)) / len(both))
    mean = sum(extent.length_mm for extent in both) / len(both)
    extent = Extent(mean, sigma, sum(extent.points for extent in both))
    return _quantity(cube.name, "edge", cube.edge_mm, extent), lines


def _diameter(scene: Scene, rod: Cylinder, label: int, face: Face | None) -> tuple[Quantity, list[EdgeLine]]:
    if face is None:
        return _quantity(rod.name, "diameter", rod.diameter_mm, None), []
    place = np.array([*rod.center_mm, rod.height_mm])
    extent, lines = circle(scene, rod.name, label, face, place, rod.diameter_mm)
    return _quantity(rod.name, "diameter", rod.diameter_mm, extent), lines


def _quantity(name: str, quantity: str, nominal_mm: float, extent: Extent | None) -> Quantity:
    if extent is None:
        return Quantity(name, quantity, nominal_mm, float("nan"), float("nan"), 0)
    return Quantity(name, quantity, nominal_mm, extent.length_mm, extent.sigma_mm, extent.points)


def _radius(sphere: Sphere, ball: Ball | None) -> Quantity:
    extent = ball and Extent(ball.radius_mm, ball.sigma_mm, ball.points)
    return _quantity(sphere.name, "radius", sphere.diameter_mm / 2, extent)


def _height(feature: Cube | Cylinder, top: Face | None, base: Face, errors: FaceErrors) -> Quantity:
    """Of the upper face's middle over the base's plane."""
    nominal = feature.edge_mm if isinstance(feature, Cube) else feature.height_mm
    if top is None:
        return _quantity(feature.name, "height", nominal, None)
    height, slope = base.above(top.middle_mm)
    variance = top.depth_variance(errors.area_px) + errors.area_px * float(slope @ base.covariance @ slope)
    variance += 2 * errors.flat_mm**2
    return _quantity(feature.name, "height", nominal, Extent(height, float(np.sqrt(variance)), top.points))


def _steps(module: Module, faces: dict[str, Face], errors: FaceErrors) -> list[Quantity]:
    """Between cubes next in size: the difference of their heights, in which much of the base's error falls out."""
    base, steps = faces["base"], []
    cubes = sorted(module.cube, key=lambda cube: -cube.edge_mm)
    for large, small in pairwise(cubes):
        upper, lower = faces.get(large.name), faces.get(small.name)
        extent = None
        if upper and lower:
            (high, slope), (low, other) = base.above(upper.middle_mm), base.above(lower.middle_mm)
            variance = upper.depth_variance(errors.area_px) + lower.depth_variance(errors.area_px)
            variance += 2 * errors.flat_mm**2 + errors.area_px * float(
                (slope - other) @ base.covariance @ (slope - other)
            )
            extent = Extent(high - low, float(np.sqrt(variance)), upper.points + lower.points)
        name = f"step:{large.name}-{small.name}"
        steps.append(_quantity(name, "height_difference", large.edge_mm - small.edge_mm, extent))
    return steps


def _warnings(
    module: Module, quantities: Sequence[Quantity], edges: Sequence[EdgeLine], patterned: bool
) -> tuple[str, ...]:
    names = [feature.name for feature in module.features]
    missing = [q for q in quantities if np.isnan(q.measured_mm)]
    lost = [n for n in names if all(q in missing for q in quantities if q.name == n)]
    told = [f"{name}: not measured; it is missing, hidden, or not where module.toml has it" for name in lost]
    told += [
        f"{q.name}: {q.quantity} not measured; too little of it is seen"
        for q in missing
        if q.name not in lost
    ]
    if not patterned:
        told.append(
            "the frame has no image.png: spheres are not corrected for the matcher's smoothing; reconstruct again"
        )
    by_rim = sorted({edge.name for edge in edges if not edge.by_image})
    if by_rim:
        told.append(f"{', '.join(by_rim)}: edges by the depth map's rim alone, to about a pixel")
    return tuple(told)
