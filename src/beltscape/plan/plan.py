"""The plan of a rig: mounting, baseline, coverage, precision, motion and light from the settings.

The mounting height of the core camera is the paper's Eq. 26, extended by material and margins. The plan as plain
values is the content of plan.json and of ``--json``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from beltscape.core.errors import InputError
from beltscape.plan.baseline import Alternative, choose_baseline, list_alternatives
from beltscape.plan.coverage import PlaneCoverage, compute_coverage, usable_length_mm
from beltscape.plan.light import LightBudget, Motion, compute_light_budget, compute_motion, defocus_px
from beltscape.plan.planned_rig import PlannedRig, SigmaMap, make_planned_rig, predict_sigma_map
from beltscape.plan.settings import PlanSettings

CLEARANCE_MM = 50.0
"""Minimum distance between lenses and load, for their housing and a swinging lump; chosen."""


@dataclass(frozen=True, slots=True)
class Mounting:
    """Heights in mm; those named ``above_belt`` are above the level middle of the belt."""

    eq26_mm: float
    """Eq. 26 with the stated angle: from the lens down to the idlers' vertices."""
    eq26_lens_mm: float
    """Eq. 26 with the angle from pixels and focal length."""
    recommended_above_belt_mm: float
    """Height from which the span and the top of the load are seen, with a margin on either side."""
    above_belt_mm: float
    """Height of the core camera in this plan."""

    def depth_mm(self, height_mm: float) -> float:
        """Return the depth in the core camera of a surface at this height above the level middle."""
        return self.above_belt_mm - height_mm


def mounting_height_mm(span_mm: float, angle_rad: float) -> float:
    """Return Eq. 26, h ≥ (w/2) / tan(α/2): the minimum height from which an angle α covers a span w.

    References
    ----------
    Hou, Kang & Qiao, Sensors 2025, 25(7), 2111, doi:10.3390/s25072111, Eq. 26.
    """
    return span_mm / 2 / float(np.tan(angle_rad / 2))


def compute_mounting(settings: PlanSettings) -> Mounting:
    """Return the heights of a plan, or raise InputError where the belt does not fit the view."""
    belt, camera, rig = settings.belt, settings.camera, settings.rig
    angle = min(camera.angle_rad, camera.lens_angle_rad)
    needed = [height + mounting_height_mm(width + 2 * rig.margin_mm, angle) for height, width in belt.planes]
    recommended = max(needed)
    least = belt.edge_mm + mounting_height_mm(belt.span_mm, angle)
    _check_lens(settings, least)
    height = rig.height_mm or min(recommended, rig.max_height_mm)
    _check_height(settings, height, least, recommended)
    return Mounting(
        eq26_mm=mounting_height_mm(belt.span_mm, camera.angle_rad),
        eq26_lens_mm=mounting_height_mm(belt.span_mm, camera.lens_angle_rad),
        recommended_above_belt_mm=recommended,
        above_belt_mm=height,
    )


def _check_lens(settings: PlanSettings, least: float) -> None:
    belt, rig, focal = settings.belt, settings.rig, settings.camera.focal_mm
    if least <= rig.max_height_mm:
        return
    longest = focal * (rig.max_height_mm - belt.edge_mm) / (least - belt.edge_mm)
    fix = f"give a lens of at most {np.floor(longest * 10) / 10:g} mm" if longest >= 1 else "give more height"
    raise InputError(
        f"max_height_mm = {rig.max_height_mm:g}: a lens of {focal:g} mm sees the span of {belt.span_mm:g} mm "
        f"only from {np.ceil(least):g} mm above the belt on; {fix}"
    )


def _check_height(settings: PlanSettings, height: float, least: float, recommended: float) -> None:
    belt, rig = settings.belt, settings.rig
    key = "max_height_mm" if rig.height_mm is None else "height_mm"
    if height > rig.max_height_mm:
        raise InputError(f"height_mm = {height:g} is above max_height_mm = {rig.max_height_mm:g}; lower it")
    if height < least:
        raise InputError(
            f"{key} = {height:g}: a lens of {settings.camera.focal_mm:g} mm does not see the span of "
            f"{belt.span_mm:g} mm from that height; give at least {np.ceil(least):g} mm, recommended are "
            f"{np.ceil(recommended):g} mm"
        )
    if height <= belt.top_mm + CLEARANCE_MM:
        raise InputError(
            f"{key} = {height:g}: the load reaches {belt.top_mm:g} mm and would touch the cameras; "
            f"give at least {np.floor(belt.top_mm + CLEARANCE_MM) + 1:g} mm"
        )


_ANGLE_DEG = 0.5
"""Difference of stated and computed angle of view from which the plan warns; makers round to whole degrees."""
_HEIGHT_MM = 0.5
"""Difference of heights that is rounding of the setting."""
_DEFOCUS_PX = 2.0
"""Diameter of the blur disc from which the plan warns; chosen, since dots of the speckle are a few pixels wide."""
_ENOUGH_LIGHT = 0.995
"""Share of the target SNR that suffices, so that a setting computed by the plan and rounded is not refused."""


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A planned rig."""

    settings: PlanSettings
    mounting: Mounting
    alternatives: tuple[Alternative, ...]
    chosen: Alternative
    planned: PlannedRig
    planes: tuple[PlaneCoverage, ...]
    """The belt's level middle, its edges, the top of the load."""
    sigma: tuple[SigmaMap, ...]
    """Maps of σ at the same heights."""
    motion: Motion
    light: LightBudget
    defocus_px: tuple[float, ...]
    """Blur disc at the same heights; the focus makes the nearest and the farthest equally sharp."""
    warnings: tuple[str, ...]

    @property
    def required_views(self) -> int:
        """Return the number of auxiliaries that must see a point."""
        return self.settings.rig.required_views

    @property
    def is_dark(self) -> bool:
        """True if the light does not reach the target SNR."""
        return self.light.snr < _ENOUGH_LIGHT * self.settings.light.target_snr

    @property
    def is_blurred(self) -> bool:
        """True if the motion blur exceeds its limit by more than rounding."""
        return self.motion.blur_px > self.settings.light.max_blur_px * (1 + 1e-9)

    @property
    def sigma_median_mm(self) -> float:
        """Return the median σ over the span at the height of the belt's edges."""
        return float(np.nanmedian(self.sigma[1].sigma_mm))

    @property
    def sigma_in_this_light_mm(self) -> float:
        """Return the same with the matching noise of the planned light; inf in the dark."""
        precision = self.settings.precision
        matching = np.sqrt(max(self.sigma_median_mm**2 - precision.calibration_sigma_mm**2, 0.0))
        factor = self.light.matching_sigma_px / precision.sigma_px
        return float(np.hypot(matching * factor, precision.calibration_sigma_mm))


def make_plan(settings: PlanSettings) -> Plan:
    """Plan a rig, or raise InputError with the reason why there is none."""
    mounting = compute_mounting(settings)
    height = mounting.above_belt_mm
    candidates = list_alternatives(settings, height)
    if not candidates:
        raise InputError(
            f"focal_mm = {settings.camera.focal_mm:g}: every tilted camera would see the horizon; "
            "give a longer focal length"
        )
    best = choose_baseline(settings, candidates)
    planned = make_planned_rig(settings, height, best.baseline_mm)
    planes = compute_coverage(settings, planned)
    length = usable_length_mm(planes, 1)
    core = planned.rig.core
    motion = compute_motion(settings, planes[-1].pixel_mm[core][0], length)
    lit_area = _lit_area_mm2(settings, planes[0])
    light = compute_light_budget(settings, mounting.depth_mm(0.0), lit_area, motion.exposure_us)
    map_length = planes[1].core_length_mm or planes[0].core_length_mm
    maps = tuple(predict_sigma_map(settings, planned, plane.height_mm, map_length) for plane in planes)
    near, far = (
        mounting.depth_mm(settings.belt.top_mm),
        mounting.depth_mm(min(settings.belt.material_mm[0], 0.0)),
    )
    focus = 2 * near * far / (near + far)
    blur = tuple(defocus_px(settings, focus, mounting.depth_mm(plane.height_mm)) for plane in planes)
    plan = Plan(settings, mounting, candidates, best, planned, planes, maps, motion, light, blur, ())
    return _add_warnings(plan)


def _lit_area_mm2(settings: PlanSettings, belt: PlaneCoverage) -> float:
    """Return the area of the projector's picture: as given, or a rectangle about the core's view of the belt."""
    given = settings.light.lit_area_mm
    if given is not None:
        return given[0] * given[1]
    across, along = np.ptp(belt.polygons["cam0"], axis=0)
    return float(across * along)


def _add_warnings(plan: Plan) -> Plan:
    return replace(plan, warnings=(*_geometry_warnings(plan), *_light_warnings(plan)))


def _geometry_warnings(plan: Plan) -> list[str]:
    settings, mounting = plan.settings, plan.mounting
    camera = settings.camera
    warnings: list[str] = []
    stated, lens = np.rad2deg(camera.angle_rad), np.rad2deg(camera.lens_angle_rad)
    if camera.angle_deg is not None and abs(stated - lens) > _ANGLE_DEG:
        warnings.append(
            f"the stated angle of view is {stated:.1f}°, but {camera.size_px[0]} pixels of "
            f"{camera.pitch_um:g} µm behind "
            f"{camera.focal_mm:g} mm see {lens:.2f}° without distortion: Eq. 26 requires "
            f"{mounting.eq26_mm:.1f} mm with the "
            f"one and {mounting.eq26_lens_mm:.1f} mm with the other; the plan relies on the narrower"
        )
    if mounting.above_belt_mm < mounting.recommended_above_belt_mm - _HEIGHT_MM:
        warnings.append(
            f"the core hangs {mounting.recommended_above_belt_mm - mounting.above_belt_mm:.0f} mm below the "
            "recommended height: "
            "high load at the belt's edges leaves the image"
        )
    if plan.chosen.refused:
        warnings.append(f"the baseline of {plan.chosen.baseline_mm:g} mm is not ideal: {plan.chosen.refused}")
    for plane in plan.planes:
        if plane.lengths_mm[1] == 0:
            warnings.append(
                f"at the {plane.name} the full width of {plane.width_mm:.0f} mm is not seen by two cameras"
            )
    if max(plan.defocus_px) > _DEFOCUS_PX:
        warnings.append(
            f"out of focus by up to {max(plan.defocus_px):.1f} px between belt and top; close the aperture"
        )
    return warnings


def _light_warnings(plan: Plan) -> list[str]:
    settings, motion, light = plan.settings, plan.motion, plan.light
    warnings: list[str] = []
    if settings.camera.max_fps < motion.fps < np.inf:
        warnings.append(
            f"{motion.fps:.1f} frames a second are needed, the camera gives {settings.camera.max_fps:g}: at most "
            f"{motion.max_speed_m_s:.2f} m/s with {settings.frames_per_point} frames per point"
        )
    if 1e6 < motion.exposure_us * motion.fps < np.inf:
        warnings.append(
            f"an exposure of {motion.exposure_us:.0f} µs does not fit {motion.fps:.1f} frames a second"
        )
    if plan.is_blurred:
        warnings.append(
            f"{motion.blur_px:.2f} px of motion blur; expose at most {motion.max_exposure_us:.0f} µs for "
            f"{settings.light.max_blur_px:g} px"
        )
    if light.snr == 0:
        warnings.append("the projector is off: a bare belt has no texture to match")
    elif plan.is_dark:
        warnings.append(
            f"too little light: SNR {light.snr:.1f} in {light.exposure_us:.0f} µs, "
            f"{settings.light.target_snr:g} requested; "
            f"it takes {light.needed_exposure_us:.0f} µs or {light.needed_lumens:.0f} lm while exposing (a flash), "
            "or a wider aperture"
        )
    if light.saturated:
        warnings.append("white surfaces saturate at this exposure; coal and rubber do not")
    return warnings


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
