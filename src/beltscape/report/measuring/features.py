"""The report page of the calibration module: dimensions, fitted pixels, and deviation from the nominal surface.

Its pictures show pixels by feature, magnified edges, and deviation from the nominal module.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.frames import Image
from beltscape.core.geometry.camera import Camera
from beltscape.measure.features.result import EdgeLine, MeasuredDimension, MeasuredModule
from beltscape.measure.features.solids import NO_PART
from beltscape.report.drawing.depth_picture import NO_TRUTH
from beltscape.report.drawing.legend import DIFFERENCE, QUIET, Color, Rgb, Scale, Swatches, round_above
from beltscape.report.drawing.pictures import Mark, Panel, to_rgb
from beltscape.report.drawing.scene import Scene
from beltscape.report.page import InteractiveScene, Pictures, Section, Table, Tile, Tiles, render

_COLORS: tuple[Color, ...] = (
    (134, 142, 150), (25, 113, 194), (232, 89, 12), (47, 158, 68), (156, 54, 181), (224, 49, 49), (240, 140, 0),
    (12, 133, 153), (92, 64, 51), (194, 37, 92),
)  # fmt: skip
"""Colours of the features by their label, in turn; neighbours differ in hue."""
FOUND, PERFECT = (0, 225, 255), (255, 140, 0)
"""Colours of measured and nominal edges; cyan and orange are distinct for colour-blind readers."""
_MARGIN_PX = 12
"""Margin of a cut-out about a feature, px of the depth map."""
_SCENE_POINTS = 12_000
"""Largest number of points of a scene, which bounds the size of the page."""


def make_feature_panel(depth: DepthMap, camera: Camera, measured: MeasuredModule) -> Panel:
    """Return the fitted pixels in their feature's colour over the grey depth, with the located edges."""
    rows, columns = _crop_to_module(measured)
    z = depth.depth_mm[rows, columns]
    low, high = np.nanquantile(z, [0.01, 0.99]) if np.isfinite(z).any() else (0.0, 1.0)
    shade = np.nan_to_num((high - z) / max(high - low, 1e-6))
    image = np.repeat((60 + 120 * np.clip(shade, 0, 1))[..., None], 3, axis=2)
    names = ["base", *(feature.name for feature in measured.module.features)]
    for label, name in enumerate(names):
        here = _fitted_mask(depth, measured, label, name)[rows, columns]
        image[here] = 0.35 * image[here] + 0.65 * np.array(_color(label))
    big, zoom = _enlarge(image.astype(np.uint8), 1400)
    for line in measured.edges:
        _draw(big, line.line_mm, camera, (rows.start, columns.start), zoom, (255, 255, 255))
    marks: list[Mark] = []
    for name, where in _label_positions(measured):
        u, v = _pixels(where[None], camera)[0] - [columns.start, rows.start]
        marks.append(Mark(name, (float(u + 0.5) / z.shape[1], float(v + 0.5) / z.shape[0])))
    return Panel(big, "what was fitted", Swatches([("located edge", (255, 255, 255))]), marks=marks)


def make_deviation_panel(depth: DepthMap, measured: MeasuredModule) -> Panel:
    """Return measured minus nominal depth on the module, mm."""
    rows, columns = _crop_to_module(measured)
    on = measured.view.label[rows, columns] != NO_PART
    off = np.where(on, depth.depth_mm[rows, columns] - measured.view.depth_mm[rows, columns], np.nan)
    finite = np.abs(off[np.isfinite(off)])
    limit = round_above(max(float(np.quantile(finite, 0.9)), 0.01)) if finite.size else 1.0
    scale = Scale(-limit, limit, DIFFERENCE)
    key = Swatches([("not measured", QUIET), ("not the module", NO_TRUTH)])
    image = scale.to_rgb(off)
    image[~on] = NO_TRUTH
    note = f"median {np.median(finite):.3f}" if finite.size else ""
    big, _ = _enlarge(image, 1400)
    return Panel(big, "measured minus perfect, mm", scale, key, note)


def make_edge_panels(
    image: Image | None, depth: DepthMap, camera: Camera, measured: MeasuredModule
) -> Iterator[Panel]:
    """Yield each feature's upper face magnified, with its measured and nominal edges."""
    key = Swatches([("located", FOUND), ("perfect module", PERFECT)])
    ground = to_rgb(image) if image is not None else _shade_relief(depth)
    for name in dict.fromkeys(line.name for line in measured.edges):
        lines = [line for line in measured.edges if line.name == name]
        points = np.concatenate([_pixels(line.line_mm, camera) for line in lines])
        size = np.array(camera.size_px)
        low = np.clip(np.floor(points.min(axis=0)).astype(int) - _MARGIN_PX, 0, size - 2)
        high = np.clip(np.ceil(points.max(axis=0)).astype(int) + _MARGIN_PX, low + 2, size)
        big, zoom = _enlarge(ground[low[1] : high[1], low[0] : high[0]], 900)
        for line in lines:
            for edge_mm, color in ((line.nominal_mm, PERFECT), (line.line_mm, FOUND)):
                _draw(big, edge_mm, camera, (int(low[1]), int(low[0])), zoom, color)
        yield Panel(big, name, key, note=_sigmas(lines))


def make_feature_scene(depth: DepthMap, camera: Camera, measured: MeasuredModule) -> Scene:
    """Return the cloud coloured by feature, with outlines of faces and circles of spheres."""
    on = (measured.view.label != NO_PART) & depth.measured
    labels = measured.view.label[on]
    every = max(len(labels) // _SCENE_POINTS, 1)
    points = depth.points_mm(camera)[on][::every]
    near = np.abs(points[:, 2] - measured.view.depth_mm[on][::every]) < 5.0
    colors = np.array([_color(label) for label in labels[::every]], np.uint8)
    lines = [("#2b8a3e" if line.by_image else "#868e96", line.line_mm) for line in measured.edges]
    for ball in measured.spheres.values():
        lines += [("#c92a2a", ring) for ring in _rings(ball.center_mm, ball.radius_mm)]
    return Scene(tuple(lines), tuple(_label_positions(measured)), points[near], colors[near])


def _label_positions(measured: MeasuredModule) -> list[tuple[str, NDArray[np.float64]]]:
    """Return the measured features' names and label positions (3,) in the core's frame."""
    balls = [(name, ball.center_mm) for name, ball in measured.spheres.items()]
    return balls + [(name, face.middle_mm) for name, face in measured.faces.items() if name != "base"]


def _rings(center: NDArray[np.float64], radius: float) -> Iterator[NDArray[np.float64]]:
    """Yield three great circles."""
    angle = np.linspace(0, 2 * np.pi, 49)
    for skip in range(3):
        ring = np.insert(np.stack([np.cos(angle), np.sin(angle)], axis=1), skip, 0.0, axis=1)
        yield center + radius * ring


def _fitted_mask(depth: DepthMap, measured: MeasuredModule, label: int, name: str) -> NDArray[np.bool_]:
    """Return the mask (H, W) of the pixels of a face's plane or of a sphere's cap."""
    if name in measured.faces:
        return measured.faces[name].pixels
    shown = measured.view.face(label) & depth.measured
    return shown if name in measured.spheres else np.zeros_like(shown)


def _crop_to_module(measured: MeasuredModule) -> tuple[slice, slice]:
    """Return the rows and columns that show the module, with a margin."""
    on = measured.view.label != NO_PART
    spans: list[slice] = []
    for axis in (1, 0):
        occupied = np.nonzero(on.any(axis=axis))[0]
        size = on.shape[1 - axis]
        low, high = (int(occupied[0]), int(occupied[-1])) if len(occupied) else (0, size)
        spans.append(slice(max(low - _MARGIN_PX, 0), min(high + _MARGIN_PX + 1, size)))
    return spans[0], spans[1]


def _color(label: int) -> Color:
    return _COLORS[label % len(_COLORS)]


def _shade_relief(depth: DepthMap) -> Rgb:
    z = depth.depth_mm
    low, high = np.nanquantile(z, [0.01, 0.99])
    grey = np.nan_to_num(np.clip((high - z) / max(high - low, 1e-6), 0, 1))
    return np.repeat((40 + 200 * grey).astype(np.uint8)[..., None], 3, axis=2)


def _enlarge(image: Rgb, width_px: int) -> tuple[Rgb, float]:
    """Return the image enlarged by a whole factor to about the given width, and the factor."""
    zoom = max(round(width_px / image.shape[1]), 1)
    big = cv2.resize(np.ascontiguousarray(image), None, fx=zoom, fy=zoom, interpolation=cv2.INTER_NEAREST)
    return np.asarray(big, np.uint8), float(zoom)


def _pixels(points_mm: NDArray[np.float64], camera: Camera) -> NDArray[np.float64]:
    """Return the pixels (n, 2) of points on the undistorted grid."""
    return points_mm[:, :2] / points_mm[:, 2:] * camera.focal_px + camera.center_px


def _draw(
    image: Rgb,
    line_mm: NDArray[np.float64],
    camera: Camera,
    origin: tuple[int, int],
    zoom: float,
    color: Color,
) -> None:
    """Draw a polyline into an enlarged part of the core's view whose first row and column are ``origin``."""
    at = (_pixels(line_mm, camera) - [origin[1], origin[0]] + 0.5) * zoom - 0.5
    cv2.polylines(image, [np.rint(at * 16).astype(np.int32)], False, color, 2, cv2.LINE_AA, 4)


def _sigmas(lines: list[EdgeLine]) -> str:
    low, high = min(line.sigma_mm for line in lines), max(line.sigma_mm for line in lines)
    return f"σ of an edge {low:.2f} mm" if high - low < 0.005 else f"σ of an edge {low:.2f} to {high:.2f} mm"


def render_features_page(
    depth: DepthMap, camera: Camera, image: Image | None, measured: MeasuredModule
) -> str:
    """Return report.html of a module's dimensions."""
    edges = list(make_edge_panels(image, depth, camera, measured))
    sections = [
        Section("Dimensions", "Each feature measured by itself.", [_tiles(measured), _table(measured)]),
        Section(
            "What was fitted",
            "The pixels that planes and spheres were fitted to, by feature; edges in white.",
            [
                Pictures(
                    [make_feature_panel(depth, camera, measured)], "Faces, caps and edges in the core's view."
                ),
                InteractiveScene(
                    make_feature_scene(depth, camera, measured),
                    "The cloud by feature, with fitted primitives.",
                ),
            ],
        ),
        Section(
            "Against the perfect module",
            "Measured depth minus that of the perfect module at the pose found: blue nearer, red farther.",
            [Pictures([make_deviation_panel(depth, measured)])],
        ),
        Section(
            "Edges",
            "Upper faces from close by, with their edges as located and as the perfect module has them.",
            [Pictures(edges, columns=2)] if edges else [],
        ),
    ]
    return render(
        f"Dimensions of {measured.module.name}",
        summarise_module(measured),
        sections,
        warnings=measured.warnings,
    )


def summarise_module(measured: MeasuredModule) -> str:
    """Return the result in a sentence."""
    measurable = [q for q in measured.quantities if np.isfinite(q.measured_mm)]
    if not measurable:
        return "The module was found, but none of its dimensions could be measured."
    worst = max(measurable, key=lambda q: abs(q.measured_mm - q.nominal_mm))
    beyond = sum(abs(q.measured_mm - q.nominal_mm) > 3 * q.sigma_mm for q in measurable)
    return (
        f"{len(measurable)} of {len(measured.quantities)} dimensions measured; the farthest from nominal is "
        f"{worst.name} {worst.quantity.replace('_', ' ')}, {_signed(worst)} mm; {beyond} differ by more than 3 σ."
    )


def _signed(quantity: MeasuredDimension) -> str:
    return f"{quantity.measured_mm - quantity.nominal_mm:+.3f}".replace("-", "−")


_GROUPS = (
    ("heights and steps", ("height", "height_difference")),
    ("edges of cubes", ("edge",)),
    ("radii of spheres", ("radius",)),
    ("diameters", ("diameter",)),
    ("length and width of the base", ("length", "width")),
)


def _tiles(measured: MeasuredModule) -> Tiles:
    """Return the largest deviation of each kind of dimension."""
    tiles: list[Tile] = []
    for title, kinds in _GROUPS:
        off = [(abs(q.measured_mm - q.nominal_mm), q) for q in measured.quantities if q.quantity in kinds]
        off = [(value, q) for value, q in off if np.isfinite(value)]
        if off:
            value, quantity = max(off, key=lambda pair: pair[0])
            note = f"off nominal, the largest of {len(off)}; σ {quantity.sigma_mm:.3f} mm"
            tiles.append(Tile(title, f"{value:.3f}", "mm", note))
    return Tiles(tiles)


def _table(measured: MeasuredModule) -> Table:
    rows: list[list[str]] = []
    for q in measured.quantities:
        values = ["–", "–", "–", "–"]
        if np.isfinite(q.measured_mm):
            ratio = (q.measured_mm - q.nominal_mm) / q.sigma_mm
            values = [
                f"{q.measured_mm:.3f}",
                _signed(q),
                f"{q.sigma_mm:.3f}",
                f"{ratio:+.1f}".replace("-", "−"),
            ]
        rows.append(
            [f"{q.name} {q.quantity.replace('_', ' ')}", f"{q.nominal_mm:.3f}", *values, str(q.points)]
        )
    columns = ["dimension", "nominal mm", "measured mm", "error mm", "σ mm", "error / σ", "points"]
    return Table(columns, rows, "Points: pixels of a face or cap; pieces of an edge.")
