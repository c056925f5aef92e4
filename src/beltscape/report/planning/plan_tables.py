"""The tables of the plan's report."""

from __future__ import annotations

import numpy as np

from beltscape.plan.plan import Plan
from beltscape.report.page import Table


def make_poses_table(plan: Plan) -> Table:
    """Tabulate the position of each lens."""
    rows: list[list[str]] = []
    for name in plan.planned.rig.cameras:
        x, y, z = plan.planned.position_mm(name)
        axis = plan.planned.cam_from_world(name).rotation[2]
        tilt = np.rad2deg(np.arccos(np.clip(-axis[2], -1, 1)))
        rows.append([name, f"{x:z.1f}", f"{y:z.1f}", f"{z:.1f}", f"{tilt:.2f}"])
    return Table(
        ["camera", "x across mm", "y along mm", "z up mm", "tilt °"],
        rows,
        "Lenses' positions over the belt's middle.",
    )


def make_alternatives_table(plan: Plan) -> Table:
    """Tabulate the baselines and the reasons against them."""
    count = plan.settings.rig.auxiliaries
    levels = sorted({1, plan.required_views, count})
    rows = [
        [
            f"{candidate.baseline_mm:.0f}" + (" ◄" if candidate is plan.chosen else ""), f"{candidate.tilt_deg:.1f}",
            f"{candidate.sigma_mm:.4f}", *(f"{100 * candidate.seen[k]:.1f}" for k in levels),
            f"{100 * candidate.covered[1]:.1f}", f"{100 * candidate.covered[-1]:.1f}", candidate.refused or "–",
        ]
        for candidate in plan.alternatives
    ]  # fmt: skip
    names = ["baseline mm", "tilt °", "σ mm", *(f"≥ {k} see %" for k in levels)]
    caption = (
        "σ where all axes meet. Seen: past lumps; covered: in the image, over the strip that the core sees."
    )
    return Table([*names, "≥ 1 cover %", "all cover %", "against it"], rows, caption)


def make_coverage_table(plan: Plan) -> Table:
    """Tabulate the shares seen and the lengths of belt."""
    count = plan.settings.rig.auxiliaries
    names = ["plane", "height mm", "width mm", *(f"core + ≥ {k} %" for k in range(1, count + 1))]
    rows = [
        [
            plane.name, f"{plane.height_mm:.0f}", f"{plane.width_mm:.0f}",
            *(f"{100 * share:.1f}" for share in plane.at_least[1:]),
            f"{plane.lengths_mm[0]:.0f}", f"{plane.lengths_mm[1]:.0f}", f"{plane.lengths_mm[-1]:.0f}",
        ]
        for plane in plan.planes
    ]  # fmt: skip
    caption = "Shares of the strip; and along the belt, how long its whole width is seen."
    return Table([*names, "by core mm", "by ≥ 2 mm", "by all mm"], rows, caption)


def make_pixels_table(plan: Plan) -> Table:
    """Tabulate the pixel sizes on the belt."""
    rows = [
        [name, *("{1:.3f} ({0:.3f} … {2:.3f})".format(*plane.pixel_mm[name]) for plane in plan.planes)]
        for name in plan.planned.rig.cameras
    ]
    caption = "Edge of a pixel on the plane, mm: median (finest … coarsest)."
    return Table(["camera", *(plane.name for plane in plan.planes)], rows, caption)


def make_motion_table(plan: Plan) -> Table:
    """Tabulate exposure, frame rate and data rate."""
    motion, camera = plan.motion, plan.settings.camera
    rows = [
        ["longest exposure for the allowed blur", f"{motion.max_exposure_us:.0f} µs"],
        ["motion blur in this plan", f"{motion.blur_mm:.3f} mm, {motion.blur_px:.2f} px"],
        ["frame rate without gaps", f"{motion.gap_free_fps:.2f} per second"],
        [f"with {plan.settings.frames_per_point} frames per point", f"{motion.fps:.2f} per second"],
        ["fastest belt with that many", f"{motion.max_speed_m_s:.1f} m/s at {camera.max_fps:g} per second"],
        ["data of all cameras", f"{motion.data_mb_s:.0f} MB/s"],
    ]
    return Table(["", ""], rows)


def make_light_table(plan: Plan) -> Table:
    """Tabulate electrons, noise and the required light."""
    light = plan.light
    blur = ", ".join(
        f"{name} {px:.1f}" for name, px in zip(("belt", "edges", "top"), plan.defocus_px, strict=True)
    )
    rows = [
        ["projector on the belt", f"{light.illuminance_lux:.0f} lx"],
        ["electrons in a lit dot, in a gap", f"{light.dot_e:.0f}, {light.gap_e:.0f}"],
        ["noise in a dot", f"{light.noise_e:.1f}"],
        ["SNR of a dot", f"{light.snr:.1f} (requested {plan.settings.light.target_snr:g})"],
        ["exposure for the requested SNR", f"{light.needed_exposure_us:.0f} µs"],
        ["or projector while exposing", f"{light.needed_lumens:.0f} lm"],
        ["light in the image's corner", f"{100 * light.corner:.0f} %"],
        ["out of focus, px", blur],
    ]
    return Table(["", ""], rows)
