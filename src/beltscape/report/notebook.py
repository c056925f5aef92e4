"""The pictures of results in a notebook, and by their method ``plot``."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable, Sequence
from html import escape
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from beltscape.core.depth import DepthMap
from beltscape.core.display import Displayed
from beltscape.core.empty_belt import Belt
from beltscape.core.geometry.rig import Rig
from beltscape.core.ledger import FlowRecord
from beltscape.measure.lumps.lumps import Lumps
from beltscape.measure.volume.volume import Volume
from beltscape.report.drawing.depth_picture import make_depth_panel, make_sigma_panel
from beltscape.report.drawing.legend import HEIGHT, Scale
from beltscape.report.drawing.palette import light
from beltscape.report.drawing.pictures import Panel, quantile_range
from beltscape.report.drawing.plots import WIDE, make_panels, to_png
from beltscape.report.measuring.belt import plot_section
from beltscape.report.measuring.flow import plot_flow
from beltscape.report.measuring.lumps import plot_distribution
from beltscape.report.measuring.volume import plot_heights

_AXIS_SHARE = 0.25
"""Length of the drawn optical axes over the largest distance of a camera from the core."""


def plot(result: Any) -> Figure:
    """Return a figure of a rig, depth map, belt, volume or lumps.

    Raises
    ------
    TypeError
        if there is no picture of such a result.
    """
    for kind, draw in _PLOTS.items():
        if isinstance(result, kind):
            return draw(result)
    raise TypeError(f"no picture of a {type(result).__name__}")


def plot_records(records: Sequence[FlowRecord]) -> Figure:
    """Plot the flow records of a moving belt."""
    return plot_flow(records, WIDE)


def render_html(result: Displayed) -> str:
    """Return the line of text of a result, and its picture as an image that is part of the text."""
    picture = b64encode(to_png(result.plot())).decode()
    return f'<p>{escape(repr(result))}</p><img style="max-width: 100%" src="data:image/png;base64,{picture}">'


def plot_rig(rig: Rig) -> Figure:
    """Plot the cameras and their optical axes from above and from the side, in the core camera's frame."""
    centers = np.array([pose.center_mm for pose in rig.cam_from_core.values()])
    axes_mm = np.array([pose.rotation[2] for pose in rig.cam_from_core.values()])
    reach = _AXIS_SHARE * max(float(np.linalg.norm(centers, axis=1).max()), 1.0)
    figure, panels = make_panels(2, WIDE, columns=2, height=300)
    views = (("x, mm", "y, mm", 0, 1, "along the core's axis"), ("x, mm", "z, mm", 0, 2, "from the side"))
    for panel, (label, other, u, v, title) in zip(panels, views, strict=True):
        for name, center, axis in zip(rig.cameras, centers, axes_mm, strict=True):
            color = light("core" if name == rig.core else "auxiliary")
            end = center + reach * axis
            panel.plot([center[u], end[u]], [center[v], end[v]], color=color, linewidth=1.4)
            panel.plot(center[u], center[v], "s", color=color, markersize=7)
            if v == 1:  # from the side, names of cameras behind one another would overlap
                panel.annotate(name, (center[u], center[v]), xytext=(7, 7), textcoords="offset points")
        panel.set(xlabel=label, ylabel=other, title=title)
        panel.margins(0.12)
        panel.set_aspect("equal", adjustable="datalim")
        panel.invert_yaxis()
        panel.grid()
    return figure


def plot_depth(depth: DepthMap) -> Figure:
    """Plot the depth and its σ."""
    return _plot_panels([make_depth_panel(depth), make_sigma_panel(depth)])


def plot_volume(volume: Volume) -> Figure:
    """Plot the load's heights, with their scale."""
    high = quantile_range(volume.load.height_mm, 0.002)[1]
    low = 0.0
    scale = Scale(low, high, HEIGHT, label="height, mm")
    figure = plot_heights(volume, scale, WIDE)
    figure.suptitle(f"height of the load, {low:.0f} (dark) to {high:.0f} mm (bright)")
    return figure


def plot_lumps(lumps: Lumps) -> Figure:
    """Plot the distribution of the lumps' sizes."""
    figure = plot_distribution(lumps, WIDE)
    figure.suptitle("all lumps (line) and those fully visible (dashed)")
    return figure


def _plot_panels(panels: Sequence[Panel]) -> Figure:
    """Return pictures with their legends side by side."""
    drawn = [panel.draw() for panel in panels]
    height, width = drawn[0].shape[:2]
    figure, axes = make_panels(
        len(drawn), WIDE, columns=len(drawn), height=WIDE.width / len(drawn) * height / width
    )
    for axis, image in zip(axes, drawn, strict=True):
        axis.imshow(image)
        axis.set_axis_off()
    return figure


_PLOTS: dict[type, Callable[[Any], Figure]] = {
    Rig: plot_rig,
    DepthMap: plot_depth,
    Belt: lambda belt: plot_section(belt, WIDE),
    Volume: plot_volume,
    Lumps: plot_lumps,
}
"""Function by the result's type."""
