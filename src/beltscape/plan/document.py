"""The plan as plain values: the content of plan.json and of ``--json``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from beltscape.plan.baseline import Alternative
from beltscape.plan.coverage import PlaneCoverage
from beltscape.plan.plan import Plan
from beltscape.plan.precision import SigmaMap

FORMAT = "beltscape-plan/1"


def plan_to_document(plan: Plan) -> dict[str, Any]:
    """Return the plan without the cells of the σ maps; world: x across, y along, z up, origin below the core."""
    mounting, planned = plan.mounting, plan.planned
    return {
        "format": FORMAT,
        "units": "mm",
        "settings": plan.settings.model_dump(mode="json"),
        "mounting": {
            **asdict(mounting),
            "angle_deg": np.rad2deg(plan.settings.camera.angle_rad),
            "lens_angle_deg": np.rad2deg(plan.settings.camera.lens_angle_rad),
            "edges_above_belt_mm": plan.settings.belt.edge_mm,
            "trough_deg": np.rad2deg(plan.settings.belt.trough_rad),
        },
        "rig": {
            "core": planned.rig.core,
            "core_from_world": _pose(planned.core_from_world),
            "baseline_mm": planned.baseline_mm,
            "tilt_deg": np.rad2deg(planned.tilt_rad),
            "target_mm": planned.target_mm,
            "cameras": {
                name: {
                    "position_mm": planned.position_mm(name),
                    "cam_from_world": _pose(planned.cam_from_world(name)),
                }
                for name in planned.rig.cameras
            },
        },
        "alternatives": [_alternative(entry, plan.chosen) for entry in plan.alternatives],
        "planes": [_plane(plane) for plane in plan.planes],
        "depth_sigma": {
            "matching_sigma_px": plan.settings.precision.sigma_px,
            "median_mm": plan.sigma_median_mm,
            "in_this_light_mm": plan.sigma_in_this_light_mm,
            "maps": [_sigma(entry) for entry in plan.sigma],
        },
        "motion": asdict(plan.motion),
        "light": asdict(plan.light),
        "defocus_px": list(plan.defocus_px),
    }


def _pose(pose: Any) -> dict[str, Any]:
    return {"rotation": pose.rotation, "translation_mm": pose.translation_mm}


def _alternative(alternative: Alternative, chosen: Alternative) -> Mapping[str, Any]:
    return {**asdict(alternative), "chosen": alternative is chosen}


def _plane(plane: PlaneCoverage) -> Mapping[str, Any]:
    return {
        "name": plane.name,
        "height_mm": plane.height_mm,
        "width_mm": plane.width_mm,
        "polygons_mm": dict(plane.polygons),
        "all_cameras_mm": plane.all_cameras,
        "seen_by_at_least": list(plane.at_least),
        "overlap": dict(plane.overlap),
        "lengths_mm": list(plane.lengths_mm),
        "pixel_mm": {name: list(edges) for name, edges in plane.pixel_mm.items()},
    }


def _sigma(sigma_map: SigmaMap) -> Mapping[str, Any]:
    finite = sigma_map.sigma_mm[np.isfinite(sigma_map.sigma_mm)]
    low, middle, high = np.percentile(finite, [0, 50, 100]) if len(finite) else (np.nan,) * 3
    return {
        "height_mm": sigma_map.height_mm,
        "best_mm": low,
        "median_mm": middle,
        "worst_mm": high,
        "seen": float(np.isfinite(sigma_map.sigma_mm).mean()),
    }
