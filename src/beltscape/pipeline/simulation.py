"""Simulation of a scenario: a capture folder as the cameras would record it, and its truth beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.checks import is_dict
from beltscape.core.errors import InputError
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.files.arrays import write_arrays
from beltscape.files.atomic import ensure_output_folder, write_text
from beltscape.files.images import EXTENSIONS, write_image
from beltscape.files.json_text import write_json
from beltscape.files.paths import read_text
from beltscape.files.rig_json import write_rig
from beltscape.files.tiff import write_float_tiff
from beltscape.files.toml_text import read_toml, validate
from beltscape.report.control_pictures import draw_simulated_frame
from beltscape.simulate.core_truth import label_rocks, trace_core_view
from beltscape.simulate.rendering.optics import Lens
from beltscape.simulate.rendering.render import resolve_engine
from beltscape.simulate.rig_and_projector import DOWN
from beltscape.simulate.scenario import KINDS, Scenario
from beltscape.simulate.scene_assembly import SimulatedScene
from beltscape.simulate.solids.belt import BeltSettings
from beltscape.simulate.time_of_flight import make_tof_camera, render_tof
from beltscape.simulate.truth_files import (
    SceneDetails,
    compute_true_load,
    label_rocks_from_above,
    write_belt,
    write_boards,
    write_rocks,
    write_station,
    write_truth,
)
from beltscape.simulate.world import World
from beltscape.target.pattern import PRESETS
from beltscape.target.print_board import board_to_toml


def read_scenario(scene: str, overrides: Mapping[str, Any]) -> Scenario:
    """Read a scene by its name, or from its TOML file; ``overrides`` take precedence over the file.

    ``overrides`` has the file's form: a value by key, tables as mappings. Paths in the file are relative to
    its folder.

    Raises
    ------
    InputError
        With one line that names the key, the value and the permitted values.
    """
    path = Path(scene)
    if scene in KINDS:
        values: dict[str, Any] = {"kind": scene}
    elif path.suffix == ".toml":
        values = read_toml(path)
        _resolve_paths(values, path.parent)
    else:
        raise InputError(f"{scene}: no such scene; give a .toml file, or one of {', '.join(KINDS)}")
    for key, value in overrides.items():
        base = values.get(key, {})
        if not isinstance(value, Mapping):
            values[key] = value
        elif isinstance(base, Mapping):  # the validation below reports a value that is no table
            values[key] = {**base, **value}
    return validate(path if path.suffix == ".toml" else Path(scene), Scenario, values)


def simulate(scenario: Scenario, out: Path, reporter: Reporter) -> Mapping[str, Any]:
    """Render the capture and write it with its truth; return the paths and numbers of the result.

    Raises
    ------
    InputError, SettingsError
        Before anything is written, if the scene cannot be rendered or the folder holds another capture.
    OutputError
        If the folder cannot be written to.
    """
    scenario = _with_engine(scenario)
    scene = SimulatedScene(scenario)
    _check_scene(scene)
    _check_folder(scene, out)
    ensure_output_folder(out)
    count = scene.frame_count
    _write_truth(scene, out / "truth", reporter)
    for frame in range(count):
        images = scene.render_frame(frame)
        for name, image in images.images.items():
            write_image(out / name / f"{images.frame}.png", image)
        if scenario.tof is not None:
            _write_tof(scene, frame, out / "tof")
        if frame == count // 2:  # the middle frame shows a moving heap
            view = trace_core_view(scene.world_at(frame), scene.station)
            write_image(out / "preview.png", draw_simulated_frame(images, view.depth_mm))
        reporter.step("rendering", frame + 1, count)
    if scenario.kind == "belt_moving":
        write_text(out / "encoder.csv", _format_encoder(scene))
    if scene.board is not None:
        write_text(out / "board.toml", board_to_toml(scene.board))
    if scene.module is not None:
        write_text(out / "module.toml", read_text(scene.module_file))
    cameras = list(scene.station.rig.cameras)
    return {
        "scene": scenario.kind,
        "capture": out,
        "truth": out / "truth",
        "preview": out / "preview.png",
        "cameras": cameras,
        "frames": count,
    }


def _with_engine(scenario: Scenario) -> Scenario:
    """Return the scene with the engine that renders it, so that its truth names the engine."""
    engine = resolve_engine(scenario.render.engine)
    return scenario.model_copy(update={"render": scenario.render.model_copy(update={"engine": engine})})


def _check_scene(scene: SimulatedScene) -> None:
    """Make all objects that may be refused, before anything is written."""
    cameras, scenario = scene.station.rig.cameras, scene.scenario
    for name, camera in scenario.faults.list_cameras():
        if camera not in cameras:
            raise InputError(f"faults.{name}: the rig has no camera {camera}; it has {', '.join(cameras)}")
    for fault in scenario.faults.running_off:
        validate(
            Path("faults.running_off"),
            BeltSettings,
            fault.apply(scenario.belt, scene.frame_count).model_dump(),
        )
    _ = (scene.station_at(0), scene.projector, scene.heap, scene.world_from_module, scene.world_from_board)
    for camera in cameras.values():
        Lens(camera, scenario.optics, 1).make_coarse_pinhole()  # raises if the distortion folds


def _check_folder(scene: SimulatedScene, out: Path) -> None:
    """Raise InputError if images of another capture would remain among the new ones."""
    frames = range(scene.frame_count)
    expected = {
        out / name / f"{scene.frame_name(frame)}.png"
        for frame in frames
        for name in scene.delivering_cameras(frame)
    }
    others = sorted(
        path for path in out.glob("*/*") if path.suffix.lower() in EXTENSIONS and path not in expected
    )
    if others:
        raise InputError(
            f"{out}: holds another capture ({others[0].relative_to(out)}); choose another folder"
        )


def _resolve_paths(values: dict[str, Any], folder: Path) -> None:
    """Make the relative paths of a scene's file relative to its folder."""
    for table, key in (("rig", "file"), ("module", "file"), ("board", "file"), ("projector", "pattern")):
        values_of_table = values.get(table)
        if (
            is_dict(values_of_table)
            and isinstance(values_of_table.get(key), str)
            and values_of_table[key] not in PRESETS
        ):
            values_of_table[key] = str(folder / values_of_table[key])


def _write_truth(scene: SimulatedScene, folder: Path, reporter: Reporter) -> None:
    scenario = scene.scenario
    reporter.step("truth", 0, 1)
    write_json(folder / "scenario.json", scenario.model_dump(mode="json"))
    if scene.board is not None:
        poses = {scene.frame_name(i): pose for i, pose in enumerate(scene.world_from_board)}
        write_boards(folder, scene.station, scene.board, poses)
    elif scenario.kind == "belt_moving":
        _write_moving_truth(scene, folder)
    else:
        details = SceneDetails(scenario.belt, scene.heap, scene.module, scene.world_from_module)
        write_truth(folder, scenario.kind, scene.world_at(0), scene.station, details)
    reporter.step("truth", 1, 1)


def _write_moving_truth(scene: SimulatedScene, folder: Path) -> None:
    """Write the heap's position in every frame, its cross-sections from end to end, and the core's true depth."""
    scenario = scene.scenario
    write_station(folder, scene.station, scene.projector)
    write_belt(folder, scenario.belt)
    left, right = scenario.belt.half_width_mm
    half = scenario.belt.length_mm / 2
    still = World((*scene.belt, *(scene.heap.solids if scene.heap else ())), None)
    load = compute_true_load(still, (-left, right), (-half, half), 1.0)
    heap = scene.heap
    on_top = {} if heap is None else {"rock": label_rocks_from_above(still, heap, load.x_mm, load.y_mm)}
    write_arrays(
        folder / "belt_moving_load.npz",
        x_mm=load.x_mm,
        y_mm=load.y_mm,
        height_mm=load.height_mm.astype(np.float32),
        area_mm2=load.area_mm2,
        **on_top,
    )
    depths: list[NDArray[np.float32]] = []
    labels: list[NDArray[np.uint8]] = []
    rocks: list[NDArray[np.int32]] = []
    for frame in range(scene.frame_count):
        world = scene.world_at(frame)
        view = trace_core_view(world, scene.station)
        if heap is not None:
            rocks.append(label_rocks(view, world.solids, heap))
        depths.append(view.depth_mm.astype(np.float32))
        labels.append(view.label)
    seen = {"rock": np.stack(rocks)} if rocks else {}
    write_arrays(folder / "belt_moving_depth.npz", depth_mm=np.stack(depths), label=np.stack(labels), **seen)
    if heap is not None:
        write_rocks(folder / "belt_moving_rocks.npz", heap)
    frames = [
        {
            "frame": scene.frame_name(i),
            "timestamp_s": scene.time_s(i),
            "belt_position_mm": scene.belt_position_mm(i),
            "heap_mm": scene.heap_position_mm(i),
        }
        for i in range(scene.frame_count)
    ]
    document = {
        "units": "mm",
        "heap_mm": "where the middle of the heap's own heights (belt_moving_load.npz) lies in the world",
        "speed_mm_s": scenario.motion.speed_mm_s,
        "heap_volume_mm3": load.volume_mm3,
        "frames": frames,
    }
    write_json(folder / "belt_moving.json", document)


def _format_encoder(scene: SimulatedScene) -> str:
    """Return encoder.csv: the readings of all frames, without those of a silent encoder."""
    scale, frames = scene.scenario.motion.encoder_scale, range(scene.frame_count)
    position = np.array([abs(scene.belt_position_mm(i)) * scale for i in frames])
    for fault in scene.scenario.faults.encoder:
        position = fault.apply(position)
    rows = [
        f"{scene.frame_name(i)},{scene.time_s(i)!r},{float(position[i])!r}"
        for i in frames
        if np.isfinite(position[i])
    ]
    return "\n".join(["frame,timestamp_s,belt_position_mm", *rows]) + "\n"


def _write_tof(scene: SimulatedScene, frame: int, folder: Path) -> None:
    """Write the depth of the time-of-flight camera as a reconstruction, the input of `measure`."""
    spec = scene.scenario.tof
    if spec is None:
        return
    tof_from_world = Pose(DOWN.copy(), DOWN @ np.array([0.0, 0.0, -spec.height_mm]))
    tof_frame = render_tof(scene.world_at(frame), tof_from_world, spec.camera, seed=scene.frame_seed(frame))
    camera = replace(make_tof_camera(spec.camera), name="tof")
    write_rig(folder / "rig.json", Rig("tof", {"tof": camera}, {"tof": Pose.identity()}))
    for name, values in (
        ("depth", tof_frame.depth_mm),
        ("sigma", tof_frame.sigma_mm),
        ("amplitude", tof_frame.amplitude_e),
    ):
        write_float_tiff(folder / scene.frame_name(frame) / f"{name}.tiff", values.astype(np.float32))
