"""The engineer's 3-D viewer: an offline WebGL page of point clouds, cameras, surfaces and primitives."""

from __future__ import annotations

import gzip
import json
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from beltscape.report.drawing.legend import HEIGHT, UNCERTAINTY, Rgb
from beltscape.report.drawing.pictures import quantile_range

if TYPE_CHECKING:
    from jinja2 import Environment

AXES = (("x", "#ff8787"), ("y", "#8ce99a"), ("z", "#74c0fc"))
_COLOUR, _HEIGHT, _SIGMA, _CLAY = range(4)
"""Colour modes of a cloud, as numbered in viewer.js."""
_LIBRARIES = {
    "three-core": "three.core.min.js",
    "three": "three.module.min.js",
    "orbit": "OrbitControls.js",
}
"""Name of a library in viewer.js → its file; 0.25 MB in the page, a tenth of a frame of a megapixel."""
_RAMP = 17
"""Number of colours of a ramp in viewer.js."""
_VIEWING_DISTANCE = 2.3
"""Viewing distance in radii of the scene."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewerCloud:
    """The points of one frame."""

    name: str
    points_mm: NDArray[np.floating]
    """(N, 3), z upwards."""
    normals: NDArray[np.floating]
    """(N, 3) unit length in the same frame; NaN where unknown."""
    colors: NDArray[np.uint8]
    """(N, 3) RGB."""
    sigma_mm: NDArray[np.floating]
    """(N,) one standard deviation."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewerScene:
    """The contents of the viewer in mm, z upwards; layers are switched by their names."""

    title: str
    note: str
    clouds: Sequence[ViewerCloud] = ()
    lines: Sequence[tuple[str, str, NDArray[np.float64]]] = ()
    """(layer, colour "#rrggbb", (n, 3) polyline)."""
    surfaces: Sequence[tuple[str, str, NDArray[np.float64]]] = ()
    """(layer, colour, (T, 3, 3) triangles)."""
    labels: Sequence[tuple[str, str, NDArray[np.float64]]] = ()
    """(layer, text, (3,) where)."""


def render_viewer_page(view: ViewerScene) -> str:
    """Return the page as text; it works offline."""
    scene = json.dumps(_document(view), separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    template = _environment().get_template("viewer.html")
    return template.render(title=view.title, note=view.note, scene=scene, libraries=_pack_libraries())


@cache
def _pack_libraries() -> dict[str, str]:
    """Return the modules of three.js, compressed, by the names that viewer.js gives them."""
    folder = files("beltscape") / "data" / "web" / "vendor" / "three"
    return {
        name: b64encode(gzip.compress((folder / file).read_bytes(), mtime=0)).decode("ascii")
        for name, file in _LIBRARIES.items()
    }


@cache
def _environment() -> Environment:
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    assets = files("beltscape.report") / "assets"
    return Environment(
        loader=FunctionLoader(lambda name: (assets / name).read_text(encoding="utf-8")),
        autoescape=True,
        undefined=StrictUndefined,
    )


def _document(view: ViewerScene) -> dict[str, Any]:
    heights = np.concatenate([cloud.points_mm[:, 2] for cloud in view.clouds] or [np.zeros(0)])
    sigmas = np.concatenate([cloud.sigma_mm for cloud in view.clouds] or [np.zeros(0)])
    low, high = quantile_range(heights, 0.005)
    top = quantile_range(sigmas, 0.03)[1]
    modes = [
        {
            "mode": _HEIGHT,
            "text": "height",
            "range": [f"{round(low)}", f"{round(high)} mm"],
            "what": "z",
            "ramp": _ramp(HEIGHT[40:]),
        },
        {"mode": _COLOUR, "text": "colour", "range": None, "what": ""},
        {
            "mode": _SIGMA,
            "text": "σ",
            "range": ["0", f"{top:.3g} mm"],
            "what": "σ, dark: sure",
            "ramp": _ramp(UNCERTAINTY),
        },
        {"mode": _CLAY, "text": "clay", "range": None, "what": ""},
    ]
    return {
        "frames": [_pack_cloud(cloud, top) for cloud in view.clouds],
        "lines": [{"layer": a, "colour": b, "line": np.round(line, 2).tolist()} for a, b, line in view.lines],
        "surfaces": [
            {"layer": a, "colour": b, "triangles": np.round(corners.reshape(-1, 3), 2).tolist()}
            for a, b, corners in view.surfaces
        ],
        "labels": [{"layer": a, "text": b, "at": np.round(at, 2).tolist()} for a, b, at in view.labels],
        "modes": modes if view.clouds else [],
        "heights": [low, high],
        "axes": AXES,
        "home": _initial_view(view),
    }


def _ramp(colormap: Rgb) -> list[list[int]]:
    """Return a colour map's colours at the ends of the 16 straight pieces that the viewer draws it by."""
    return colormap[np.rint(np.linspace(0, len(colormap) - 1, _RAMP)).astype(int)].tolist()


def _pack_cloud(cloud: ViewerCloud, sigma_top_mm: float) -> dict[str, Any]:
    """Return a cloud with 16-bit positions in its bounding box, 8-bit normals, and σ as fourth colour channel."""
    points = np.asarray(cloud.points_mm, np.float64)
    low = points.min(axis=0) if len(points) else np.zeros(3)
    step = np.maximum(np.ptp(points, axis=0) if len(points) else np.ones(3), 1e-3) / 65_535
    normals = np.zeros((len(points), 4), np.int8)
    normals[:, :3] = np.rint(127 * np.nan_to_num(cloud.normals))
    sigma = np.clip(255 * np.nan_to_num(cloud.sigma_mm) / sigma_top_mm, 0, 255).astype(np.uint8)
    return {
        "name": cloud.name,
        "count": len(points),
        "low": low.tolist(),
        "step": step.tolist(),
        "spacing": _spacing(points),
        "place": _base64(np.rint((points - low) / step).astype("<u2")),
        "normal": _base64(normals),
        "colour": _base64(np.column_stack([_brighten(cloud.colors), sigma])),
    }


def _spacing(points: NDArray[np.float64]) -> float:
    """Return the point spacing, estimated from the neighbours of a sample of points."""
    if len(points) < 8:
        return 1.0
    some = points[:: max(1, len(points) // 2000)]
    distance = np.asarray(KDTree(points).query(some, 8)[0])
    return float(np.median(distance[:, -1])) * np.sqrt(np.pi / 7)  # seven neighbours in that circle


def _brighten(colors: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the colours with dark scenes brightened."""
    top = max(float(np.quantile(colors.max(axis=1), 0.98)), 1.0) if len(colors) else 1.0
    return np.rint(255 * np.clip(colors / top, 0, 1) ** 0.7).astype(np.uint8)


def _base64(values: NDArray[np.generic]) -> str:
    return b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")


def _initial_view(view: ViewerScene) -> dict[str, Any]:
    """Return the initial view, with the whole scene in the picture."""
    lines = [line for _, _, line in view.lines]
    parts = [
        np.quantile(cloud.points_mm, [0.01, 0.5, 0.99], axis=0)
        for cloud in view.clouds
        if len(cloud.points_mm)
    ]
    everything = np.concatenate(parts or lines or [np.zeros((1, 3))])
    middle = (everything.min(axis=0) + everything.max(axis=0)) / 2
    reach = float(np.linalg.norm(np.ptp(everything, axis=0))) / 2 or 100.0
    return {"turn": -0.5, "tilt": 0.85, "reach": _VIEWING_DISTANCE * reach, "middle": middle.tolist()}
