"""The plan's report: feasibility, positions of all devices, coverage and precision."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from beltscape.plan.light import CORE_WIDTH_PX
from beltscape.plan.plan import Plan
from beltscape.report.drawing.charts import Chart
from beltscape.report.drawing.legend import DARK_IS_CERTAIN, UNCERTAINTY, Scale
from beltscape.report.drawing.plots import Form, compute_map_height, fade_unmeasured, make_panels, show_map
from beltscape.report.drawing.scene import make_rig_scene
from beltscape.report.page import InteractiveScene, Section, Table, Tile, Tiles, render
from beltscape.report.plan_drawing import make_side_charts, make_top_chart


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
        [
            f"processor cores for it, preset fast, images {min(CORE_WIDTH_PX, camera.size_px[0])} px wide",
            f"about {motion.cores:.0f}",
        ],
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


def render_plan_page(plan: Plan) -> str:
    """Return report.html of a plan."""
    sections = [
        Section("The plan", "", [_make_tiles(plan)]),
        Section(
            "Where everything goes", _describe_mounting(plan),
            [*make_side_charts(plan), make_top_chart(plan), make_poses_table(plan), _make_scene(plan)],
        ),
        Section("Baseline", _describe_baseline(plan), [make_alternatives_table(plan)]),
        Section(
            "What is seen",
            "Shares of the strip of belt that the core sees. Occlusion by lumps is in the table above.",
            [make_coverage_table(plan), make_pixels_table(plan)],
        ),
        Section("Depth", _describe_sigma(plan), [make_sigma_chart(plan)]),
        Section("A moving belt", _describe_motion(plan), [make_motion_table(plan)]),
        Section("Light", _describe_light(plan), [make_light_table(plan)]),
    ]  # fmt: skip
    return render("Rig plan", summarise(plan), sections, warnings=plan.warnings)


def summarise(plan: Plan) -> str:
    """Summarise the plan in a sentence or two."""
    mounting, count, edges = plan.mounting, len(plan.planned.rig.cameras), plan.planes[1]
    seen = edges.at_least[plan.required_views]
    text = (
        f"{count} cameras: the core {mounting.above_belt_mm:.0f} mm above the belt, the others "
        f"{plan.planned.baseline_mm:.0f} "
        f"mm from it and tilted by {np.rad2deg(plan.planned.tilt_rad):.1f}°, see {seen:.1%} of the "
        "belt under the core "
        f"{plan.required_views + 1} times, with {edges.pixel_mm['cam0'][1]:.2f} mm pixels and a depth σ of "
        f"{plan.sigma_median_mm:.3f} mm from matching. "
    )
    shortages: list[str] = []
    if plan.is_dark:
        shortages.append(
            f"light (SNR {plan.light.snr:.1f}, which makes σ {plan.sigma_in_this_light_mm:.2f} mm)"
        )
    if plan.motion.fps > plan.settings.camera.max_fps:
        shortages.append("frame rate")
    if plan.is_blurred:
        shortages.append("a shorter exposure")
    return text + (
        f"What is missing: {', '.join(shortages)}." if shortages else "Light and frame rate suffice."
    )


def _make_tiles(plan: Plan) -> Tiles:
    mounting, motion, core = plan.mounting, plan.motion, plan.planes[1].pixel_mm["cam0"]
    return Tiles(
        [
            Tile("least height by Eq. 26", f"{mounting.eq26_mm:.1f}", "mm", "lens to the idlers' vertices"),
            Tile("core above the belt", f"{mounting.above_belt_mm:.0f}", "mm",
                 f"recommended {mounting.recommended_above_belt_mm:.0f} mm"),
            Tile("baseline", f"{plan.planned.baseline_mm:.0f}", "mm",
                 f"tilt {np.rad2deg(plan.planned.tilt_rad):.2f}°"),
            Tile("pixel at the belt's edges", f"{core[1]:.3f}", "mm"),
            Tile("depth σ, matching", f"{plan.sigma_median_mm:.3f}", "mm",
                 f"{plan.sigma_in_this_light_mm:.3f} mm in this light"),
            Tile("frames per second", f"{motion.fps:.1f}", "",
                 f"{motion.gap_free_fps:.1f} without gaps; {motion.data_mb_s:.0f} MB/s"),
            Tile("exposure", f"{motion.exposure_us:.0f}", "µs", f"{motion.blur_px:.2f} px of motion blur"),
            Tile("SNR of a dot", f"{plan.light.snr:.1f}", "", f"{plan.settings.light.target_snr:g} requested"),
        ]
    )  # fmt: skip


def _describe_mounting(plan: Plan) -> str:
    mounting, belt = plan.mounting, plan.settings.belt
    return (
        f"Eq. 26: h ≥ (w/2) / tan(α/2) = {mounting.eq26_mm:.1f} mm for w = {belt.span_mm:g} mm and α = "
        f"{np.rad2deg(plan.settings.camera.angle_rad):.2f}°, down to the idlers' vertices, which lie "
        f"{belt.edge_mm:.0f} mm "
        f"above the level middle of the belt. Recommended is what also sees the load's top, "
        f"{plan.settings.belt.top_width_mm or belt.span_mm:.0f} mm wide at {belt.top_mm:.0f} mm, with "
        f"{plan.settings.rig.margin_mm:g} mm on either side."
    )


def _make_scene(plan: Plan) -> InteractiveScene:
    boards: dict[str, NDArray[np.float64]] = {}
    for plane in plan.planes:
        half, length = plane.width_mm / 2, max(plane.core_length_mm, 1.0) / 2
        x, y = np.array([-1, 1, 1, -1, -1]) * half, np.array([-1, -1, 1, 1, -1]) * length
        outline = np.column_stack([x, y, np.full(5, plane.height_mm)])
        boards[plane.name] = plan.planned.core_from_world.apply(outline)
    scene = make_rig_scene(plan.planned.rig, length_mm=0.3 * plan.mounting.above_belt_mm, boards_mm=boards)
    return InteractiveScene(
        scene, "The rig; grey: belt, edges and top of the load, as long as the core sees them whole."
    )


def _describe_baseline(plan: Plan) -> str:
    rig, number = plan.settings.rig, plan.required_views
    return (
        "Depth's σ falls as Z²/(f·B), but from farther aside lumps hide more. Taken is the most "
        "precise baseline from "
        f"which {number} of {rig.auxiliaries} auxiliaries see at least {rig.required_share:.0%} of the "
        "places between lumps "
        f"that the core sees, under at most {rig.max_angle_deg:g}°. Lumps: balls over "
        f"{plan.settings.belt.lump_cover:.0%} "
        "of the load, worst of its middle and edges."
    )


def _describe_sigma(plan: Plan) -> str:
    precision = plan.settings.precision
    calibration = precision.calibration_sigma_mm
    return (
        f"{precision.sigma_px:.4g} px of independent noise on each coordinate of a point in each camera, through the "
        "projections of all cameras that see it, "
        + (f"and {calibration:g} mm from calibration. " if calibration else "without calibration's part. ")
        + f"In this light matching noise would be {plan.light.matching_sigma_px:.3f} px."
    )


def make_sigma_chart(plan: Plan) -> Chart:
    """Return the σ maps as a chart, one scale for all."""
    finite = np.concatenate([sigma_map.sigma_mm[np.isfinite(sigma_map.sigma_mm)] for sigma_map in plan.sigma])
    low, high = (float(finite.min()), float(np.percentile(finite, 98))) if len(finite) else (0.0, 1.0)
    label = f"depth σ, mm; {DARK_IS_CERTAIN}"
    scale = Scale(low, max(high, low + 1e-6), UNCERTAINTY, label=label)
    return Chart.draw(partial(_draw_sigma_maps, plan, scale), "Empty: fewer than two cameras.", scale)


def _draw_sigma_maps(plan: Plan, scale: Scale, form: Form) -> Figure:
    width, length = (
        max(float(np.ptp(getattr(sigma_map, name))) for sigma_map in plan.sigma) for name in ("x_mm", "y_mm")
    )
    height = compute_map_height(form, width, length, columns=3)
    figure, axes = make_panels(len(plan.sigma), form, columns=3, height=height + 14)
    for axis, sigma_map, plane in zip(axes, plan.sigma, plan.planes, strict=True):
        extent = (sigma_map.x_mm[0], sigma_map.x_mm[-1], sigma_map.y_mm[0], sigma_map.y_mm[-1])
        show_map(
            axis,
            fade_unmeasured(
                scale.to_rgb(sigma_map.sigma_mm), sigma_map.sigma_mm, np.ones(sigma_map.sigma_mm.shape)
            ),
            extent,
        )
        axis.set(
            title=f"{plane.name}, {sigma_map.height_mm:.0f} mm", xlabel="x across, mm", ylabel="y along, mm"
        )
    return figure


def _describe_motion(plan: Plan) -> str:
    motion, belt = plan.motion, plan.settings.belt
    return (
        f"At {belt.speed_m_s:g} m/s; a frame gives {motion.frame_length_mm:.0f} mm of belt over the "
        "full width at every "
        f"height, seen by the core and another camera. Each piece of belt in {plan.settings.frames_per_point} frames "
        "lets them be fused."
    )


def _describe_light(plan: Plan) -> str:
    light = plan.settings.light
    return (
        f"{light.projector_lm:g} lm over what the core sees of the belt, {light.ambient_lux:g} lx in "
        "the hall, material of "
        f"reflectance {light.reflectance:g}, lens at f/{plan.settings.camera.f_number:g}: a diffuse "
        "surface through the "
        "camera equation, shot and read noise."
        if light.lit_area_mm is None
        else f"{light.projector_lm:g} lm over {light.lit_area_mm[0]:g} × {light.lit_area_mm[1]:g} mm."
    )
