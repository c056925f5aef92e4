"""The report page of a moving belt: total flow with uncertainty, the fused belt, and the strips."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.belt.flow_record import QUALITIES, FlowRecord
from beltscape.core.belt.height_map import HeightMap
from beltscape.measure.flow.meter import FramePlacement
from beltscape.measure.flow.records.totals import FlowTotals
from beltscape.report.measuring.flow_charts import (
    make_belt_chart,
    make_coverage_chart,
    make_flow_chart,
    make_motion_chart,
    make_state_entry,
)
from beltscape.report.page import Section, Table, Tile, Tiles, render

_MOST_ROWS = 400
"""Largest number of rows of the table; flow.csv has all."""


@dataclass(frozen=True, slots=True, eq=False)
class FlowReport:
    """The contents of the page."""

    records: Sequence[FlowRecord]
    steps: Sequence[FramePlacement]
    totals: FlowTotals
    document: Mapping[str, Any]
    """The figures of flow.json."""
    belt: HeightMap
    """The fused belt, columns x, rows s."""
    share: NDArray[np.float64]
    """Share of its cells that were measured."""


def render_flow_page(flow: FlowReport, *, warnings: Sequence[str]) -> str:
    """Return report.html of a moving belt."""
    sections = [
        Section("What passed", "", [Tiles(_tiles(flow))]),
        Section(
            "The belt",
            "All frames laid over one another where the belt had moved to: load above the empty belt. It travels to "
            "the left.",
            [make_belt_chart(flow.records, flow.belt, flow.share)],
        ),
        Section(
            "Flow",
            "Every record is the strip of belt that became new in its frame; the strips meet without gap or overlap, "
            "so their volumes add up to the total.",
            [make_flow_chart(flow.records), _key()],
        ),
        Section(
            "The belt's motion",
            "Found by laying successive height maps over one another; the projected pattern stands still and cannot "
            "tell it.",
            [make_motion_chart(flow.steps)],
        ),
        Section(
            "What fusion adds",
            "The material meets other dots, markers and shadows in every frame.",
            [make_coverage_chart(flow.records), _fusion_table(flow)],
        ),
        Section("Strips", "", [_strip_table(flow.records)]),
    ]
    return render("Flow on the belt", summarise_flow(flow), sections, warnings=warnings)


def summarise_flow(flow: FlowReport) -> str:
    """Return the result in a sentence."""
    totals, document = flow.totals, flow.document
    text = (
        f"{totals.volume_mm3 * 1e-6:.3f} ± {totals.sigma_mm3 * 1e-6:.3f} litres passed on "
        f"{totals.length_mm / 1000:.2f} m of belt towards {document['direction'] or '?'}"
    )
    if np.isfinite(totals.mass_kg):
        text += f", {totals.mass_kg:.2f} ± {totals.mass_sigma_kg:.2f} kg"
    if totals.bridged_mm > 0:
        text += f"; {totals.bridged_mm:.0f} mm of it in no frame, and interpolated"
    if totals.unseen_mm > 1:
        text += f"; {totals.unseen_mm:.0f} mm more are not counted: nothing tells what lay there"
    return text + "."


def _tiles(flow: FlowReport) -> list[Tile]:
    totals, document = flow.totals, flow.document
    relative = 100 * totals.sigma_mm3 / totals.volume_mm3 if totals.volume_mm3 > 0 else float("nan")
    mean = document["totals"]["mean_volume_flow_m3_h"]
    speeds = [record.speed_mm_s for record in flow.records if np.isfinite(record.speed_mm_s)]
    tiles = [
        Tile(
            "total volume",
            f"{totals.volume_mm3 * 1e-6:.3f}",
            "l",
            f"σ {totals.sigma_mm3 * 1e-6:.3f} l, {relative:.2f} %",
        )
    ]
    if np.isfinite(totals.mass_kg):
        tiles.append(Tile("total mass", f"{totals.mass_kg:.2f}", "kg", f"σ {totals.mass_sigma_kg:.2f} kg"))
    if mean is not None:
        tiles.append(Tile("mean flow", f"{mean:.1f}", "m³/h", f"over {document['totals']['seconds']:.2f} s"))
    if speeds:
        tiles.append(
            Tile(
                "belt speed",
                f"{np.median(speeds) / 1000:.3f}",
                "m/s",
                f"towards {document['direction'] or '?'}",
            )
        )
    tiles.append(
        Tile("belt", f"{totals.length_mm / 1000:.2f}", "m", f"{document['frame_count']} frames, each mm once")
    )
    tiles.append(
        Tile(
            "measured",
            f"{100 * totals.share:.1f}",
            "%",
            f"one frame alone: {100 * totals.single_share:.1f} %",
        )
    )
    encoder = document["encoder"]
    if encoder["compared"]:
        off = 100 * (encoder["ratio"] - 1)
        tiles.append(
            Tile("encoder off", f"{off:+.2f}", "%", f"σ {100 * encoder['sigma']:.2f} %, by the material")
        )
    return tiles


def _key() -> Table:
    meaning = {
        "measured": "seen well, and where the belt was is known",
        "degraded": "much of it hidden, or the belt's position continued at its last known speed",
        "bridged": "part of it passed between frames, interpolated between its neighbours",
        "missing": "not counted, or counted with the next frame's strip",
    }
    return Table(["quality", "means"], [[make_state_entry(name), meaning[name]] for name in QUALITIES])


def _fusion_table(flow: FlowReport) -> Table:
    fusion = flow.document["fusion"]

    def percent(value: float) -> str:
        return f"{100 * value:.2f} %"

    return Table(
        ["", "one frame", "fused"],
        [
            ["measured", percent(fusion["single_coverage"]), percent(fusion["coverage"])],
            ["not measured", percent(1 - fusion["single_coverage"]), percent(1 - fusion["coverage"])],
            [
                "noise, where frames agree",
                f"{fusion['single_noise_mm']:.3f} mm",
                f"{fusion['fused_noise_mm']:.3f} mm",
            ],
            ["left out as gross errors", percent(fusion["left_out"]), ""],
        ],
    )


def _strip_table(records: Sequence[FlowRecord]) -> Table:
    shown = records[:_MOST_ROWS]
    rows = [
        [
            r.frame,
            "" if r.time_ns is None else f"{r.time_ns * 1e-9:.3f}",
            f"{r.belt_position_mm:.1f}",
            f"{r.strip_mm[0]:.1f} … {r.strip_mm[1]:.1f}",
            f"{r.volume_mm3 * 1e-6:.4f}",
            f"{r.sigma_mm3 * 1e-6:.4f}",
            f"{r.volume_flow_m3_h:.2f}",
            f"{r.coverage:.1%}",
            make_state_entry(r.quality),
        ]
        for r in shown
    ]
    more = f"{len(records) - _MOST_ROWS} more are in flow.csv" if len(records) > _MOST_ROWS else ""
    columns = ["frame", "s", "position mm", "strip mm", "volume l", "σ l", "m³/h", "measured", "quality"]
    return Table(columns, rows, more)
