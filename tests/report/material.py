"""Results made by hand or from synthetic scenes, and their report pages."""

from __future__ import annotations

from functools import cache

import numpy as np

from beltscape.core.empty_belt import Belt, BeltDeviation, BeltEdges
from beltscape.core.geometry.pose import Pose
from beltscape.core.height_map import HeightMap
from beltscape.core.ledger import QUALITIES, FlowRecord
from beltscape.measure.flow.belt_motion import BeltPosition
from beltscape.measure.flow.meter import FramePlacement
from beltscape.measure.flow.strips import FlowTotals
from beltscape.measure.lumps.lumps import measure_lumps
from beltscape.measure.lumps.settings import LumpSettings
from beltscape.plan.plan import Plan, make_plan
from beltscape.plan.settings import PlanSettings
from beltscape.report.measuring.belt import render_belt_page
from beltscape.report.measuring.flow import FlowReport, render_flow_page
from beltscape.report.measuring.lumps import render_lumps_page
from beltscape.report.plan import render_plan_page
from beltscape.reprocessing.comparison.comparison import Comparison
from beltscape.reprocessing.comparison.page import render_comparison
from tests.evaluate.test_page import paper
from tests.reprocessing.comparison.histories import (
    OTHER_RIG,
    compared,
    degraded,
    mark_missing,
    measured,
    noisy,
    scaled,
)
from tests.synthetic.packings import camera, make_ellipsoids, render_depth_map

LIMIT_MM = 62.0


@cache
def plan() -> Plan:
    return make_plan(PlanSettings())


@cache
def lumps():
    """(lumps, depth, picture): of 20, three quarters large enough to be numbered, some over the limit."""
    eye = camera(420, 360, 490.0)
    depth, which = render_depth_map(
        make_ellipsoids(np.random.default_rng(4), columns=5, rows=4, pitch_mm=84, largest_mm=40),
        eye,
        noise_mm=0.05,
    )
    picture = np.where(which < 0, 60, 150).astype(np.uint8)
    return measure_lumps(depth, eye, LumpSettings(oversize_mm=LIMIT_MM)), depth, picture


def belt() -> Belt:
    x = np.linspace(-350, 350, 41)
    z = np.maximum(np.abs(x) - 150, 0) * np.tan(np.deg2rad(25))
    nodes = np.linspace(-200, 200, 5)
    sag = BeltDeviation(nodes, nodes, np.outer(nodes, nodes) / 4e4, np.full((5, 5), 0.01))
    edges = BeltEdges(-361.2, np.nan, 0.3, np.nan, np.nan, np.nan, "trough")
    return Belt(
        Pose.identity(), x, z, (-350.0, 350.0), (-150.0, 150.0), 0.02, 0.021, 3.0, 0.01, 1e-5, 1e-4, "shape",
        np.full(x.shape, 0.0123), (-250.0, 250.0), sag, edges, 0.02, 3,
    )  # fmt: skip


def flow(count: int = 24) -> FlowReport:
    """A belt with strips of every quality, by an encoder that is off by a hundredth."""
    records = tuple(
        FlowRecord(
            f"{k:03}", k * 200_000_000, 200.0 * k, (200.0 * k, 200.0 * (k + 1)), 3e4 + 500 * k, 6e6, 6e4,
            1000.0, 850.0, 0.93, 0.8, QUALITIES[k % len(QUALITIES)],
        )
        for k in range(count)
    )  # fmt: skip
    steps = tuple(
        FramePlacement(r.frame, BeltPosition(200.0 * k, 0.1, "material", 0.2 * k, 202.0 * k), None)
        for k, r in enumerate(records)
    )
    rows, columns = 20 * count, 60
    heights = np.abs(np.random.default_rng(1).normal(40, 20, (rows, columns)))
    heights[:, :3] = np.nan
    grid = HeightMap(heights, np.full(heights.shape, 0.1), (-300.0, 5.0), 10.0)
    totals = FlowTotals(1.4e8, 1.4e6, 120.0, 1.2, 200.0 * count, 4000.0, 200.0, 0.0, 0.93, 0.8)
    document = {
        "direction": "+y", "frame_count": count, "totals": {"mean_volume_flow_m3_h": 108.0, "seconds": 4.8},
        "encoder": {"compared": 20, "ratio": 1.01, "sigma": 1e-4},
        "fusion": {
            "single_coverage": 0.8, "coverage": 0.93, "single_noise_mm": 0.2, "fused_noise_mm": 0.1,
            "left_out": 0.003,
        },
    }  # fmt: skip
    return FlowReport(
        records, steps, totals, document, grid, np.random.default_rng(2).uniform(0, 1, heights.shape)
    )


def comparison() -> Comparison:
    """Another calibration with mark_missing frames, a stretch that differs and cameras missing."""
    records = measured(400)
    changed = [scaled([each], 1.2)[0] if 90 < each.number < 99 else each for each in noisy(records)]
    return compared(
        records, degraded(mark_missing(changed, range(150, 160)), range(200, 230)), of_second=OTHER_RIG
    )


def pages() -> dict[str, str]:
    """Name → the report as text."""
    from beltscape.evaluate.paper.page import render_paper_page

    return {
        "plan": render_plan_page(plan()),
        "belt": render_belt_page(belt()),
        "lumps": render_lumps_page(*lumps()),
        "flow": render_flow_page(flow(), warnings=["a frame lacks"]),
        "paper": render_paper_page(paper()),
        "comparison": render_comparison(comparison()),
    }
