"""The paper's laboratory: captures of all scenes, rendered once and kept, or given by the user."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

from beltscape.core.errors import InputError
from beltscape.core.progress import Reporter, Silent
from beltscape.evaluate.truth import Truth, read_truth
from beltscape.files.json_text import read_json
from beltscape.pipeline.simulation import read_scenario, simulate
from beltscape.simulate.scenario import Scenario
from beltscape.simulate.scene_assembly import SimulatedScene
from beltscape.workers.options import HERE, WorkerOptions
from beltscape.workers.tasks import collect_values

SIZES = {"full": 1.0, "half": 0.5, "quarter": 0.25}
"""Name → share of the sensor's pixels in each direction."""
SCENES: Mapping[str, Mapping[str, Any]] = {
    "calibration": {"kind": "calibration"},
    "belt_empty": {"kind": "belt_empty"},
    "belt_empty_nospeckle": {"kind": "belt_empty", "speckle": False},
    "belt_loaded": {"kind": "belt_loaded"},
    "belt_loaded_nospeckle": {"kind": "belt_loaded", "speckle": False},
    "module": {"kind": "module", "tof": {}},
    "module_nospeckle": {"kind": "module", "speckle": False},
}
"""Scene → settings that differ from the defaults, which describe the paper's laboratory."""
CALIBRATION = "calibration"


@dataclass(frozen=True, slots=True, eq=False)
class LaboratoryScene:
    """The capture of a scene with its truth."""

    name: str
    kind: str
    """Kind of the simulated scene, such as belt_loaded."""
    capture: Path
    truth: Truth
    simulation: SimulatedScene | None
    """The scene for the simulation of other sensors; None if the capture was not rendered by Beltscape."""

    def without_caches(self) -> LaboratoryScene:
        """Return the scene without the objects that its simulation has made so far, as it is sent to workers."""
        return replace(self, simulation=self.simulation and SimulatedScene(self.simulation.scenario))


@dataclass(frozen=True, slots=True, eq=False)
class Laboratory:
    """The captures of all experiments."""

    calibration: Path
    board: Path
    module: Path
    """module.toml."""
    scenes: Mapping[str, LaboratoryScene]
    """All scenes except the calibration."""


def render_laboratory(
    folder: Path, size: str, seed: int, reporter: Reporter, workers: WorkerOptions = HERE
) -> Laboratory:
    """Render the missing captures into a folder by size and seed below ``folder``.

    Raises
    ------
    InputError
        When a capture there was rendered with other settings.
    """
    home = folder / f"{size}_seed{seed}"
    missing: list[tuple[Scenario, Path]] = []
    for name, own in SCENES.items():
        values = {"seed": seed, "rig": {"scale": SIZES[size]}, **own}
        scenario = read_scenario(str(own["kind"]), {k: v for k, v in values.items() if k != "kind"})
        if not _is_complete(scenario, home / name):
            missing.append((scenario, home / name))
    collect_values(
        _render, None, missing, workers,
        lambda done: reporter.step("rendering the laboratory", len(SCENES) - len(missing) + done, len(SCENES)),
    )  # fmt: skip
    return read_laboratory(home)


def _render(_: None, task: tuple[Scenario, Path]) -> None:
    scenario, capture = task
    simulate(scenario, capture, Silent())


def read_laboratory(folder: Path) -> Laboratory:
    """Read captures named as in `SCENES`, with a truth/, board.toml and module.toml each or one for all.

    Scenes may be missing, except the calibration and one with speckle.

    Raises
    ------
    InputError
        When a required capture or file is missing.
    """
    calibration = folder / CALIBRATION
    if not calibration.is_dir():
        raise InputError(f"{calibration}: no such capture; give a folder with {', '.join(SCENES)}")
    names = [name for name in SCENES if name != CALIBRATION and (folder / name).is_dir()]
    scenes = {name: _scene(folder, name) for name in names}
    if not any(not name.endswith("_nospeckle") for name in scenes):
        raise InputError(f"{folder}: no capture with speckle in it; give belt_empty, belt_loaded or module")
    board = next((p for p in (calibration / "board.toml", folder / "board.toml") if p.is_file()), None)
    if board is None:
        raise InputError(f"{calibration / 'board.toml'}: no such file; describe the board there")
    ours = Path(str(files("beltscape") / "data" / "module.toml"))
    module = next(
        (p for p in (folder / "module" / "module.toml", folder / "module.toml") if p.is_file()), ours
    )
    return Laboratory(calibration, board, module, scenes)


def _scene(folder: Path, name: str) -> LaboratoryScene:
    own, kind = folder / name / "truth", str(SCENES[name]["kind"])
    truth = read_truth(own if own.is_dir() else folder / "truth", kind).truths[0]
    scenario = own / "scenario.json"
    simulation = SimulatedScene(_scenario(scenario)) if scenario.is_file() else None
    return LaboratoryScene(name, kind, folder / name, truth, simulation)


def _is_complete(scenario: Scenario, capture: Path) -> bool:
    """Return whether a capture is complete."""
    document = capture / "truth" / "scenario.json"
    if not document.is_file():
        return False
    if _scenario(document) != scenario:
        raise InputError(f"{capture}: rendered with other settings; remove it, or choose another --out")
    simulation = SimulatedScene(scenario)
    images = (
        capture / name / f"{simulation.frame_name(frame)}.png"
        for frame in range(simulation.frame_count)
        for name in simulation.station.rig.cameras
    )
    return (capture / "preview.png").is_file() and all(path.is_file() for path in images)


def _scenario(path: Path) -> Scenario:
    from pydantic import ValidationError

    try:
        return Scenario.model_validate(read_json(path))
    except ValidationError as error:
        raise InputError(
            f"{path}: of another version of Beltscape; remove the capture and render again"
        ) from error
