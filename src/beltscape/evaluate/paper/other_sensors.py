"""Other sensors over the same belt: structured light, a line laser, a LiDAR, and the time-of-flight camera.

The first three are the paper's future work. Each is simulated with the same surfaces, lens and sensor, and
calibrated exactly; its depth is resampled to the core's pinhole grid and compared with the same truth. By the
time-of-flight camera the module is measured (Table 3 and Fig. 17).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import median_filter

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.evaluate.frame_scores import score_frame
from beltscape.evaluate.line_laser import measure_profiles, rasterise_profiles
from beltscape.evaluate.paper.laboratory import LaboratoryScene
from beltscape.evaluate.paper.surfaces import FRAME, ScoredDepth, score_surface
from beltscape.evaluate.structured_light import decode
from beltscape.evaluate.truth import Truth
from beltscape.files.images import read_image
from beltscape.files.reconstruction import read_frame, write_frame
from beltscape.files.rig_json import write_rig
from beltscape.report.drawing.depth_picture import draw_depth_map
from beltscape.simulate.core_truth import trace_core_view
from beltscape.simulate.profile_scanners import (
    LaserSettings,
    LidarSettings,
    make_laser,
    render_line_images,
    scan_lidar,
    speckle_sigma_px,
)
from beltscape.simulate.projected_sequence import FringeSettings, make_fringe_patterns, render_sequence
from beltscape.simulate.rendering.render import RenderSettings
from beltscape.simulate.rig_and_projector import DOWN, make_projector
from beltscape.simulate.scene_assembly import SimulatedScene
from beltscape.simulate.world import Projector, Station
from beltscape.stereo.pointcloud import CloudBuilder
from beltscape.workers.options import HERE, WorkerOptions
from beltscape.workers.tasks import collect_values

SPEED_MM_S = 1000.0
"""Speed of the belt under the profile sensors."""
ALONG_MM = (-330.0, 330.0)
"""Range that the profile sensors scan, slightly longer than the evaluated one."""
BESIDE_MM = 300.0
"""Baseline of the structured-light scanner and of the laser, equal to that of the rig's cameras."""
QUICK = RenderSettings(passes=1)
"""Fringes are smooth, so one set of sub-samples suffices."""
AT_REST = RenderSettings(passes=1, ambient_samples=1)
"""The sampling error of the ambient light is equal in all images and cancels."""


@dataclass(frozen=True, slots=True)
class Baseline:
    """A sensor to compare with."""

    name: str
    what: str
    """Description in one line."""
    images: str
    """Number of images per surface."""
    measure: Callable[[SimulatedScene, int], DepthMap]
    """Scene, seed → depth on the core's pinhole grid."""
    has_even_image: bool = False
    """Whether it can also take an image under even light."""


def make_scanner_projector(simulation: SimulatedScene, *, beside: bool) -> Projector:
    """Return the projector ``BESIDE_MM`` across from the core, or at the position of the rig's projector."""
    spec = simulation.scenario.projector
    if beside:
        spec = spec.model_copy(update={"position_mm": (BESIDE_MM, 0.0, simulation.scenario.rig.height_mm)})
    return make_projector(spec)


def measure_structured_light(
    simulation: SimulatedScene, seed: int, *, beside: bool, travel_mm: float = 0.0
) -> DepthMap:
    """Return the depth by shifted fringes; the belt travels ``travel_mm`` between images."""
    light, fringes = make_scanner_projector(simulation, beside=beside), FringeSettings()
    pictures = make_fringe_patterns(fringes, light.camera.size_px)
    how = QUICK if travel_mm else AT_REST
    images = render_sequence(simulation, light, pictures, travel_mm=travel_mm, settings=how, seed=seed)
    pose = light.projector_from_world @ simulation.station.core_from_world.inverse()
    return decode(images, simulation.station.rig.core_camera, light.camera, pose, fringes)


def measure_line_laser(simulation: SimulatedScene, seed: int) -> DepthMap:
    """Return the depth by a laser line with one profile per millimetre of belt."""
    settings, station = LaserSettings(offset_mm=BESIDE_MM), simulation.station
    height = float(station.core_from_world.center_mm[2])
    laser = make_laser(settings, height)
    images = render_line_images(
        simulation.world_at(0),
        station,
        laser,
        settings,
        simulation.scenario.sensor,
        along_mm=ALONG_MM,
        blur_px=simulation.scenario.optics.psf_sigma_px,
        seed=seed,
    )
    wander = speckle_sigma_px(settings, station.rig.core_camera, height)
    scan = measure_profiles(images, station, laser, settings.step_mm, speckle_px=wander)
    return rasterise_profiles(scan, station)


def measure_lidar(simulation: SimulatedScene, seed: int) -> DepthMap:
    """Return the depth by a LiDAR with 600 profiles per second over the moving belt."""
    scan = scan_lidar(
        simulation.world_at(0), LidarSettings(), speed_mm_s=SPEED_MM_S, along_mm=ALONG_MM, seed=seed
    )
    return rasterise_profiles(scan, simulation.station)


FRAMES = FringeSettings().frames
BASELINES = (
    Baseline(
        "structured light",
        "4 shifts of 1, 8 and 64 fringes; core camera and a projector 300 mm beside it",
        f"{FRAMES} images, belt at rest",
        lambda simulation, seed: measure_structured_light(simulation, seed, beside=True),
        has_even_image=True,
    ),
    Baseline(
        "structured light, rig's projector",
        "the same with the speckle projector where the rig has it, 71 mm beside the core",
        f"{FRAMES} images, belt at rest",
        lambda simulation, seed: measure_structured_light(simulation, seed, beside=False),
        has_even_image=True,
    ),
    Baseline(
        "line laser",
        "a line 300 mm ahead of the core camera, speckle noise of a 660 nm laser at f/4",
        "1000 profiles a second at 1 m/s, perfect encoder",
        measure_line_laser,
    ),
    Baseline(
        "LiDAR profile",
        "70° in 0.083° steps from 1 m, range noise 1 mm, spot 3 mm",
        "600 profiles a second at 1 m/s, perfect encoder",
        measure_lidar,
    ),
)


def measure_baselines(
    scenes: Mapping[str, LaboratoryScene],
    out: Path,
    seed: int,
    reporter: Reporter,
    workers: WorkerOptions = HERE,
) -> Mapping[tuple[str, str], ScoredDepth]:
    """Measure every scene that can be rendered again with every baseline; write the results to ``out``."""
    simulated = {name: scene.without_caches() for name, scene in scenes.items() if scene.simulation}
    jobs = [(scene, number) for scene in simulated for number in range(len(BASELINES))]
    found = collect_values(
        _measure_baseline, (simulated, out, seed), jobs, workers,
        lambda done: reporter.step("other sensors", done, max(len(jobs), 1)),
    )  # fmt: skip
    return {(one.scene, one.by): one for one in found}


def _measure_baseline(
    shared: tuple[Mapping[str, LaboratoryScene], Path, int], job: tuple[str, int]
) -> ScoredDepth:
    scenes, out, seed = shared
    scene, baseline = scenes[job[0]], BASELINES[job[1]]
    assert scene.simulation is not None
    folder = out / baseline.name.replace(",", "").replace(" ", "_").replace("'", "") / scene.name
    return _write_depth(scene, baseline.name, folder, baseline.measure(scene.simulation, seed))


def _write_depth(scene: LaboratoryScene, name: str, folder: Path, depth: DepthMap) -> ScoredDepth:
    """Write a depth map as a reconstruction that `measure` reads; the cloud's colours are the core image's."""
    rig = scene.truth.rig
    write_rig(folder / "rig.json", rig)
    image = read_image(scene.capture / rig.core / f"{FRAME}.png")
    cloud = CloudBuilder(rig.core_camera).build(depth, image)
    write_frame(folder / FRAME, depth, cloud, draw_depth_map(depth))
    return score_surface(scene, name, folder / FRAME, depth, rig)


def measure_moving_belt(
    scene: LaboratoryScene,
    travels_mm: tuple[float, ...],
    seed: int,
    reporter: Reporter,
    workers: WorkerOptions = HERE,
) -> tuple[ScoredDepth, ...]:
    """Measure a scene by structured light for every belt travel between images."""
    found = collect_values(
        _measure_moving, (scene.without_caches(), seed), travels_mm, workers,
        lambda done: reporter.step("structured light on a moving belt", done, max(len(travels_mm), 1)),
    )  # fmt: skip
    return tuple(found)


def _measure_moving(shared: tuple[LaboratoryScene, int], travel_mm: float) -> ScoredDepth:
    scene, seed = shared
    assert scene.simulation is not None
    depth = measure_structured_light(scene.simulation, seed, beside=True, travel_mm=travel_mm)
    return score_surface(scene, f"{travel_mm:g} mm", None, depth, scene.truth.rig)


TOF = "time of flight"
SMOOTHED_PX = 9
"""Edge of the median filter applied before dimensions are measured; without it noise hides the planes."""


def measure_time_of_flight(scene: LaboratoryScene) -> ScoredDepth | None:
    """Return the depth of the capture's time-of-flight camera on its own grid; None without such a camera."""
    folder = scene.capture / "tof" / FRAME
    if scene.simulation is None or scene.simulation.scenario.tof is None or not folder.is_dir():
        return None
    found = read_frame(folder)
    height = scene.simulation.scenario.tof.height_mm
    truth = _truth(scene, found.rig, Pose(DOWN.copy(), DOWN @ [0.0, 0.0, -height]))
    scores = score_frame(found.depth, found.rig, truth)
    return ScoredDepth(scene.name, TOF, folder, found.depth, truth, scores)


def smooth_depth(found: ScoredDepth) -> ScoredDepth:
    """Return the depth after a square median filter of ``SMOOTHED_PX``; σ follows for independent noise (π/2 n)."""
    depth = found.depth
    share = np.float32(np.sqrt(np.pi / 2) / SMOOTHED_PX)
    flat = replace(
        depth, depth_mm=median_filter(depth.depth_mm, SMOOTHED_PX), sigma_mm=depth.sigma_mm * share
    )
    return replace(found, depth=flat)


def _truth(scene: LaboratoryScene, rig: Rig, tof_from_world: Pose) -> Truth:
    """Return the truth on the camera's grid; without auxiliaries no pixel counts as occluded."""
    assert scene.simulation is not None
    view = trace_core_view(scene.simulation.world_at(0), Station(rig, tof_from_world))
    return replace(
        scene.truth,
        rig=rig,
        core_from_world=tof_from_world,
        depth_mm=view.depth_mm,
        label=view.label,
        occluded=np.zeros(view.label.shape, bool),
    )
