"""Scenes of the ablation: own captures that nothing was fitted to, and those rendered by another program."""

from __future__ import annotations

import argparse
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.core.empty_belt import Belt
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Silent
from beltscape.evaluate.truth import find_true_belt
from beltscape.files.atomic import make_folder_once
from beltscape.files.images import read_image
from beltscape.files.json_text import read_json
from beltscape.measure.volume.settings import VolumeSettings
from beltscape.measure.volume.volume import Volume, measure_volume
from beltscape.pipeline.simulation import simulate
from beltscape.simulate.scenario import Scenario
from beltscape.simulate.scene_assembly import SimulatedScene
from captures import LABELS, REGION_MM, Scene, read_rendered
from matching.visibility import TrueVisibility, find_visibility, read_projector

ROOT = Path(__file__).parent.parent.parent
_SCENES = Path(__file__).with_name("scenes.toml")


@dataclass(frozen=True)
class AblationScene:
    """A scene with the empty belt of its plant."""

    scene: Scene
    belt: Belt | None
    """None where there is no load whose volume is known."""
    visibility: TrueVisibility | None
    """What the auxiliaries truly see and the projector lights; None where the truth does not say."""


def make_scene_parser(description: str | None) -> argparse.ArgumentParser:
    """Return the parser of a bench over these scenes, with the arguments that choose them."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rendered", type=Path, help="folder with captures of another renderer")
    parser.add_argument("--cache", type=Path, default=ROOT / "out" / "bench-ablation")
    parser.add_argument("--scenes", nargs="*", default=[""])
    return parser


def read_scenes(arguments: argparse.Namespace) -> Iterator[AblationScene]:
    """Yield the scenes that the arguments choose; own ones are rendered into the cache once (a minute each)."""

    def is_chosen(name: str) -> bool:
        return any(text in name for text in arguments.scenes)

    for name, table in tomllib.loads(_SCENES.read_text("utf-8")).items():
        if is_chosen(name):
            yield read_own(name, Scenario.model_validate(table), arguments.cache / name)
    if arguments.rendered is not None and arguments.rendered.is_dir():
        for name in ("belt_loaded", "module", "belt_empty"):
            if is_chosen(f"{name}, other renderer"):
                yield _read_rendered(name, arguments.rendered)


def _read_rendered(name: str, folder: Path) -> AblationScene:
    scene = replace(read_rendered(folder, name, 0), name=f"{name}, other renderer")
    visibility = find_visibility(scene.rig, scene.true_depth_mm, *read_projector(folder / "truth"))
    return AblationScene(scene, None, visibility)


def measure_load(depth: DepthMap, one: AblationScene) -> Volume | None:
    """Return the measured volume of a scene's load; None where there is no load whose volume is known."""
    if one.belt is None or one.scene.true_volume_mm3 is None:
        return None
    camera = one.scene.rig.core_camera
    return measure_volume(
        depth, one.belt, camera, VolumeSettings(), across_mm=None, along_mm=one.scene.along_mm
    )


def render_once(scenario: Scenario, folder: Path) -> None:
    """Render a scenario into a folder where it is not there yet; the folder is there only when it is complete."""
    make_folder_once(folder, lambda part: simulate(scenario, part, Silent()))


def read_own(name: str, scenario: Scenario, folder: Path) -> AblationScene:
    """Return a scene of the simulator, rendered into the folder where it is not there yet."""
    truth = folder / "truth"
    render_once(scenario, folder)
    plant = SimulatedScene(scenario.model_copy(update={"kind": "belt_empty"}))
    rig, world_from_core = plant.station.rig, plant.station.core_from_world.inverse()
    kind = scenario.kind
    with np.load(truth / f"{kind}_depth.npz") as arrays:
        depth, label = arrays["depth_mm"].astype(np.float64), arrays["label"]
        visibility = TrueVisibility(arrays["views"], arrays["lit"])
    points = world_from_core.apply(
        np.concatenate([rig.core_camera.rays() * depth[..., None], depth[..., None]], axis=-1)
    )
    lit = np.abs(points[..., 1]) <= REGION_MM
    images = {camera: read_image(folder / camera / "000.png") for camera in rig.cameras}
    region, unseen = np.isin(label, LABELS[kind]) & lit, lit & (visibility.views == 0) & np.isfinite(depth)
    scene = Scene(name, rig, FrameSet("000", images), depth, region, unseen)
    if kind != "belt_loaded":
        return AblationScene(scene, None, visibility)
    belt = find_true_belt(plant)
    volume = read_json(truth / f"{kind}_scene.json")["volume"]
    offset = float((belt.belt_from_core @ world_from_core.inverse()).translation_mm[1])
    first, last = (float(end) + offset for end in volume["along_mm"])
    return AblationScene(
        replace(scene, true_volume_mm3=volume["volume_mm3"], along_mm=(first, last)), belt, visibility
    )
