"""The experiments on several workers: the same scores and files as in one process."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from beltscape.core.progress import Silent
from beltscape.evaluate.paper import surfaces
from beltscape.evaluate.paper.laboratory import Laboratory, LaboratoryScene
from beltscape.evaluate.paper.surfaces import reconstruct_all
from beltscape.evaluate.truth import read_truth
from beltscape.files.images import write_image
from beltscape.pipeline.simulation import simulate
from beltscape.simulate.scene_assembly import SimulatedScene
from beltscape.workers.options import WorkerOptions
from tests.simulate.tiny import tiny
from tests.thorough import THOROUGH
from tests.workers.backwards import run_backwards


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory: pytest.TempPathFactory) -> Laboratory:
    """A loaded belt of 320 × 264 px under two names."""
    folder = tmp_path_factory.mktemp("laboratory")
    scenario = tiny("belt_loaded", heap={"rocks": 4})
    simulate(scenario, folder / "belt", Silent())
    truth, scene = read_truth(folder / "belt" / "truth", "belt_loaded").truths[0], SimulatedScene(scenario)
    names = "belt_loaded", "belt_loaded_nospeckle"
    scenes = {name: LaboratoryScene(name, "belt_loaded", folder / "belt", truth, scene) for name in names}
    return Laboratory(folder, folder, folder, scenes)


def rig_sizes(laboratory: Laboratory) -> dict[str, tuple[int, int]]:
    """Return the size of each camera's images."""
    rig = laboratory.scenes["belt_loaded"].truth.rig
    return {name: camera.size_px for name, camera in rig.cameras.items()}


@pytest.mark.thorough
def test_scores_and_files_are_those_of_one_process(laboratory, tmp_path, monkeypatch) -> None:
    methods = ("binocular", "multiview") if THOROUGH else ("binocular",)
    monkeypatch.setattr(surfaces, "METHODS", methods)
    monkeypatch.setattr("beltscape.workers.tasks.run_in_pool", run_backwards)
    # the first surface fails, so that the next one of its kind finds the depth range
    black = tmp_path / "black"
    for camera, (width, height) in rig_sizes(laboratory).items():
        write_image(black / camera / "000.png", np.zeros((height, width), np.uint8))
    scene = LaboratoryScene("belt_loaded", "belt_loaded", black, laboratory.scenes["belt_loaded"].truth, None)
    laboratory = Laboratory(black, black, black, {**laboratory.scenes, "belt_loaded": scene})
    rig = laboratory.scenes["belt_loaded"].truth.rig
    one, two = (
        reconstruct_all(laboratory, rig, tmp_path / name, Silent(), options)
        for name, options in (("1", WorkerOptions()), ("2", WorkerOptions(2)))
    )
    assert list(one) == list(two) == [(s, m) for s in laboratory.scenes for m in methods]
    for job, found in one.items():
        np.testing.assert_equal(asdict(found.score), asdict(two[job].score))
    files = [path.relative_to(tmp_path / "1") for path in sorted(Path(tmp_path / "1").rglob("*.*"))]
    assert len(files) > 5
    assert [f for f in files if (tmp_path / "1" / f).read_bytes() != (tmp_path / "2" / f).read_bytes()] == []
