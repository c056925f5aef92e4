"""The report page of the calibration module: dimensions, fitted pixels, and deviation from the nominal surface."""

from __future__ import annotations

import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.core.frames import Image
from beltscape.core.geometry.camera import Camera
from beltscape.measure.features.result import MeasuredModule, Quantity
from beltscape.report.measuring.features_pictures import (
    make_deviation_panel,
    make_edge_panels,
    make_feature_panel,
    make_feature_scene,
)
from beltscape.report.page import InteractiveScene, Pictures, Section, Table, Tile, Tiles, render


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


def _signed(quantity: Quantity) -> str:
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
