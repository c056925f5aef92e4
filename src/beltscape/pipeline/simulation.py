"""A scenario → a capture folder as the cameras would have left it, and its truth beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.core.errors import InputError
from beltscape.core.pose import Pose
from beltscape.core.progress import Reporter
from beltscape.core.rig import Rig
from beltscape.files.atomic import output_folder, write_text
from beltscape.files.depth_tiff import write_float_tiff
from beltscape.files.images import EXTENSIONS, write_image
from beltscape.files.json_text import write_json
from beltscape.files.rig_json import write_rig
from beltscape.files.text import read_text
from beltscape.files.toml_text import read_toml, validated
from beltscape.report.simulation import simulated_picture
from beltscape.simulate.laboratory import DOWN
from beltscape.simulate.load_truth import true_load
from beltscape.simulate.optics import Lens
from beltscape.simulate.renderer import resolve_engine
from beltscape.simulate.scenario import KINDS, Scenario
from beltscape.simulate.stage import Stage
from beltscape.simulate.tof import tof_camera
from beltscape.simulate.tof_view import tof_of
from beltscape.simulate.truth import core_view
from beltscape.simulate.truth_files import (
    Known,
    write_arrays,
    write_belt,
    write_boards,
    write_station,
    write_truth,
)
from beltscape.simulate.world import World
from beltscape.target.pattern import PRESETS
from beltscape.target.print_board import board_toml


def read_scenario(scene: str, told: Mapping[str, Any]) -> Scenario:
    """A scene by its name, or by the path of its TOML file; what was told beside it goes before the file.

    ``told`` has the file's form: a value by key, tables as mappings. Paths in the file are taken from its folder.

    Raises
    ------
    InputError
        With one line that names the key, the value and what it may be.
    """
    path = Path(scene)
    if scene in KINDS:
        values: dict[str, Any] = {"kind": scene}
    elif path.suffix == ".toml":
        values = read_toml(path)
        _resolve(values, path.parent)
    else:
        raise InputError(f"{scene}: no such scene; give a .toml file, or one of {', '.join(KINDS)}")
    for key, value in told.items():
        own = values.get(key, {})
        if not isinstance(value, Mapping):
            values[key] = value
        elif isinstance(own, Mapping):  # what is no table is told of below
            values[key] = {**own, **value}
    return validated(path if path.suffix == ".toml" else Path(scene), Scenario, values)


def simulate(scenario: Scenario, out: Path, reporter: Reporter) -> Mapping[str, Any]:
    """Render the capture and write it with its truth; the result names what was written.

    Raises
    ------
    InputError, SettingsError
        Before anything is written, when the scene cannot be rendered or the folder holds another capture.
    OutputError
        When the folder cannot be written to.
    """
    scenario = _with_engine(scenario)
    stage = Stage(scenario)
    _ready(stage)
    _alone(stage, out)
    output_folder(out)
    count = stage.frame_count
    _write_truth(stage, out / "truth", reporter)
    for frame in range(count):
        images = stage.frame(frame)
        for name, image in images.images.items():
            write_image(out / name / f"{images.frame}.png", image)
        if scenario.tof is not None:
            _write_tof(stage, frame, out / "tof")
        if frame == count // 2:  # of a moving heap: when it is there
            view = core_view(stage.world(frame), stage.station)
            write_image(out / "preview.png", simulated_picture(images, view.depth_mm))
        reporter.step("rendering", frame + 1, count)
    if scenario.kind == "belt_moving":
        write_text(out / "encoder.csv", _encoder(stage))
    if stage.board is not None:
        write_text(out / "board.toml", board_toml(stage.board))
    if stage.module is not None:
        write_text(out / "module.toml", read_text(stage.module_file))
    cameras = list(stage.station.rig.cameras)
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


def _ready(stage: Stage) -> None:
    """Everything that may be refused, before anything is written."""
    known, scenario = stage.station.rig.cameras, stage.scenario
    faults = scenario.faults
    for fault in (*faults.dirt, *faults.moved_camera, *faults.over_exposure, *faults.missing_frames):
        if fault.camera not in known:
            raise InputError(f"faults: the rig has no camera {fault.camera}; it has {', '.join(known)}")
    _ = (stage.standing, stage.projector, stage.heap, stage.world_from_module, stage.world_from_board)
    for camera in known.values():
        Lens(camera, scenario.optics, 1).coarse()  # refuses a distortion that folds


def _alone(stage: Stage, out: Path) -> None:
    """InputError when images of another capture would stay among the new ones."""
    frames = range(stage.frame_count)
    own = {out / name / f"{stage.name(frame)}.png" for frame in frames for name in stage.delivering(frame)}
    others = sorted(path for path in out.glob("*/*") if path.suffix.lower() in EXTENSIONS and path not in own)
    if others:
        raise InputError(
            f"{out}: holds another capture ({others[0].relative_to(out)}); choose another folder"
        )


def _resolve(values: dict[str, Any], folder: Path) -> None:
    """Relative paths of a scene's file, taken from its folder."""
    for table, key in (("rig", "file"), ("module", "file"), ("board", "file"), ("projector", "pattern")):
        own = values.get(table)
        if isinstance(own, dict) and isinstance(own.get(key), str) and own[key] not in PRESETS:
            own[key] = str(folder / own[key])


def _write_truth(stage: Stage, folder: Path, reporter: Reporter) -> None:
    scenario = stage.scenario
    reporter.step("truth", 0, 1)
    write_json(folder / "scenario.json", scenario.model_dump(mode="json"))
    if stage.board is not None:
        poses = {stage.name(i): pose for i, pose in enumerate(stage.world_from_board)}
        write_boards(folder, stage.station, stage.board, poses)
    elif scenario.kind == "belt_moving":
        _write_moving(stage, folder)
    else:
        known = Known(scenario.belt, stage.heap, stage.module, stage.world_from_module)
        write_truth(folder, scenario.kind, stage.world(0), stage.station, known)
    reporter.step("truth", 1, 1)


def _write_moving(stage: Stage, folder: Path) -> None:
    """Where the heap is in every frame, its cross-sections from end to end, and the depth the core has before it."""
    scenario = stage.scenario
    write_station(folder, stage.station, stage.projector)
    write_belt(folder, scenario.belt)
    left, right = scenario.belt.half_width_mm
    half = scenario.belt.length_mm / 2
    still = World((*stage.belt, *(stage.heap.solids if stage.heap else ())), None)
    load = true_load(still, (-left, right), (-half, half), 1.0)
    write_arrays(folder / "belt_moving_load.npz", y_mm=load.y_mm, area_mm2=load.area_mm2)
    depths, labels = [], []
    for frame in range(stage.frame_count):
        view = core_view(stage.world(frame), stage.station)
        depths.append(view.depth_mm.astype(np.float32))
        labels.append(view.label)
    write_arrays(folder / "belt_moving_depth.npz", depth_mm=np.stack(depths), label=np.stack(labels))
    frames = [
        {
            "frame": stage.name(i),
            "timestamp_s": stage.time_s(i),
            "belt_position_mm": stage.belt_mm(i),
            "heap_mm": stage.heap_mm(i),
        }
        for i in range(stage.frame_count)
    ]
    document = {
        "units": "mm",
        "heap_mm": "where the middle of the heap's own cross-sections (belt_moving_load.npz) lies in the world",
        "speed_mm_s": scenario.motion.speed_mm_s,
        "heap_volume_mm3": load.volume_mm3,
        "frames": frames,
    }
    write_json(folder / "belt_moving.json", document)


def _encoder(stage: Stage) -> str:
    scale = stage.scenario.motion.encoder_scale
    rows = [
        f"{stage.name(i)},{stage.time_s(i)!r},{abs(stage.belt_mm(i)) * scale!r}"
        for i in range(stage.frame_count)
    ]
    return "\n".join(["frame,timestamp_s,belt_position_mm", *rows]) + "\n"


def _write_tof(stage: Stage, frame: int, folder: Path) -> None:
    """What the time-of-flight camera measures, as a reconstruction that `measure` takes."""
    spec = stage.scenario.tof
    if spec is None:
        return
    tof_from_world = Pose(DOWN.copy(), DOWN @ np.array([0.0, 0.0, -spec.height_mm]))
    found = tof_of(stage.world(frame), tof_from_world, spec.camera, seed=stage.seed(frame))
    camera = replace(tof_camera(spec.camera), name="tof")
    write_rig(folder / "rig.json", Rig("tof", {"tof": camera}, {"tof": Pose.identity()}))
    for name, values in (
        ("depth", found.depth_mm),
        ("sigma", found.sigma_mm),
        ("amplitude", found.amplitude_e),
    ):
        write_float_tiff(folder / stage.name(frame) / f"{name}.tiff", values.astype(np.float32))
