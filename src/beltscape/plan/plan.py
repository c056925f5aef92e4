"""From what is given to the whole plan."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from beltscape.core.errors import InputError
from beltscape.plan.baseline import Alternative, choose_baseline, list_alternatives
from beltscape.plan.coverage import PlaneCoverage, compute_coverage, usable_length_mm
from beltscape.plan.light import LightBudget, compute_light_budget, defocus_px
from beltscape.plan.motion import Motion, compute_motion
from beltscape.plan.mounting import Mounting, compute_mounting
from beltscape.plan.precision import SigmaMap, predict_sigma_map
from beltscape.plan.settings import PlanSettings
from beltscape.plan.station import PlannedRig, make_planned_rig


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A rig before it exists."""

    settings: PlanSettings
    mounting: Mounting
    alternatives: tuple[Alternative, ...]
    chosen: Alternative
    planned: PlannedRig
    planes: tuple[PlaneCoverage, ...]
    """The belt's level middle, its edges, the load at its highest."""
    sigma: tuple[SigmaMap, ...]
    """At the same heights."""
    motion: Motion
    light: LightBudget
    defocus_px: tuple[float, ...]
    """Blur disc at the same heights, focused so that nearest and farthest are equally sharp."""
    warnings: tuple[str, ...]

    @property
    def required_views(self) -> int:
        """How many auxiliaries have to see a place."""
        return self.settings.rig.required_views

    @property
    def sigma_median_mm(self) -> float:
        """Over the span at the height of the belt's edges, matching noise as set."""
        return float(np.nanmedian(self.sigma[1].sigma_mm))

    @property
    def sigma_in_this_light_mm(self) -> float:
        """The same with matching noise as this light makes it; inf in the dark."""
        precision = self.settings.precision
        matching = np.sqrt(max(self.sigma_median_mm**2 - precision.calibration_sigma_mm**2, 0.0))
        factor = self.light.matching_sigma_px / precision.sigma_px
        return float(np.hypot(matching * factor, precision.calibration_sigma_mm))


def make_plan(settings: PlanSettings) -> Plan:
    """Plan a rig, or InputError with the reason why there is none."""
    hang = compute_mounting(settings)
    height = hang.above_belt_mm
    candidates = list_alternatives(settings, height)
    if not candidates:
        raise InputError(
            f"focal_mm = {settings.camera.focal_mm:g}: every tilted camera would see the horizon; give a longer lens"
        )
    best = choose_baseline(settings, candidates)
    planned = make_planned_rig(settings, height, best.baseline_mm)
    planes = compute_coverage(settings, planned)
    length = usable_length_mm(planes, 1)
    core = planned.rig.core
    move = compute_motion(settings, planes[-1].pixel_mm[core][0], length)
    lit = _lit_area_mm2(settings, planes[0])
    light = compute_light_budget(settings, hang.depth_mm(0.0), lit, move.exposure_us)
    map_length = planes[1].core_length_mm or planes[0].core_length_mm
    maps = tuple(predict_sigma_map(settings, planned, plane.height_mm, map_length) for plane in planes)
    near, far = hang.depth_mm(settings.belt.top_mm), hang.depth_mm(min(settings.belt.material_mm[0], 0.0))
    focus = 2 * near * far / (near + far)
    blur = tuple(defocus_px(settings, focus, hang.depth_mm(plane.height_mm)) for plane in planes)
    plan = Plan(settings, hang, candidates, best, planned, planes, maps, move, light, blur, ())
    return _add_warnings(plan)


def _lit_area_mm2(settings: PlanSettings, belt: PlaneCoverage) -> float:
    """What the projector lights: as told, or a rectangle about the core's view of the belt."""
    told = settings.light.lit_area_mm
    if told is not None:
        return told[0] * told[1]
    across, along = np.ptp(belt.polygons["cam0"], axis=0)
    return float(across * along)


def _add_warnings(plan: Plan) -> Plan:
    return replace(plan, warnings=(*_geometry_warnings(plan), *_light_warnings(plan)))


def _geometry_warnings(plan: Plan) -> list[str]:
    settings, hang = plan.settings, plan.mounting
    camera, found = settings.camera, []
    stated, lens = np.rad2deg(camera.angle_rad), np.rad2deg(camera.lens_angle_rad)
    if abs(stated - lens) > 0.5:
        found.append(
            f"the stated angle of view is {stated:.1f}°, but {camera.size_px[0]} pixels of "
            f"{camera.pitch_um:g} µm behind "
            f"{camera.focal_mm:g} mm see {lens:.2f}° without distortion: Eq. 26 asks for "
            f"{hang.eq26_mm:.1f} mm with the "
            f"one and {hang.eq26_lens_mm:.1f} mm with the other; the plan relies on the narrower"
        )
    if hang.above_belt_mm < hang.recommended_above_belt_mm - 0.5:
        found.append(
            f"the core hangs {hang.recommended_above_belt_mm - hang.above_belt_mm:.0f} mm below the "
            "recommended height: "
            "high load at the belt's edges leaves the image"
        )
    if plan.chosen.refused:
        found.append(f"the baseline of {plan.chosen.baseline_mm:g} mm has its price: {plan.chosen.refused}")
    for plane in plan.planes:
        if plane.lengths_mm[1] == 0:
            found.append(
                f"at the {plane.name} the full width of {plane.width_mm:.0f} mm is not seen by two cameras"
            )
    if max(plan.defocus_px) > 2:
        found.append(
            f"out of focus by up to {max(plan.defocus_px):.1f} px between belt and top; close the aperture"
        )
    return found


def _light_warnings(plan: Plan) -> list[str]:
    settings, move, light = plan.settings, plan.motion, plan.light
    found = []
    if settings.camera.max_fps < move.fps < np.inf:
        found.append(
            f"{move.fps:.1f} frames a second are needed, the camera gives {settings.camera.max_fps:g}: at most "
            f"{move.max_speed_m_s:.2f} m/s with {settings.frames_per_point} frames per point"
        )
    if 1e6 < move.exposure_us * move.fps < np.inf:
        found.append(f"an exposure of {move.exposure_us:.0f} µs does not fit {move.fps:.1f} frames a second")
    if move.blur_px > settings.light.max_blur_px * (1 + 1e-9):
        found.append(
            f"{move.blur_px:.2f} px of motion blur; expose at most {move.max_exposure_us:.0f} µs for "
            f"{settings.light.max_blur_px:g} px"
        )
    if light.snr == 0:
        found.append("the projector is off: nothing tells places of a bare belt apart")
    elif light.snr < 0.995 * settings.light.target_snr:
        found.append(
            f"too little light: SNR {light.snr:.1f} in {light.exposure_us:.0f} µs, "
            f"{settings.light.target_snr:g} asked; "
            f"it takes {light.needed_exposure_us:.0f} µs or {light.needed_lumens:.0f} lm while exposing (a flash), "
            "or a wider aperture"
        )
    if light.saturated:
        found.append("white surfaces saturate at this exposure; coal and rubber do not")
    return found
