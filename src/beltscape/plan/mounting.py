"""The mounting height of the core camera: the paper's Eq. 26, extended by material and margins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltscape.core.errors import InputError
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
