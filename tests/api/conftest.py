"""The shipped scenes, reconstructed once through the Python interface."""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from pathlib import Path

import pytest

import beltscape as bs
from tests.once import make_once
from tests.synthetic.demo import DEMO, TRUE_RIG


@dataclass(frozen=True)
class Scene:
    """One frame of a scene and its depth."""

    frame: bs.FrameSet
    depth: bs.DepthMap


@pytest.fixture(scope="session")
def rig() -> bs.Rig:
    return bs.read_rig(TRUE_RIG)


@pytest.fixture(scope="session")
def scenes(tmp_path_factory, rig: bs.Rig) -> dict[str, Scene]:
    def make(folder: Path) -> None:
        matcher = bs.Reconstructor(rig, preset="fast")
        made = {
            name: Scene(frame, matcher(frame))
            for name in ("belt_empty", "belt_loaded", "module")
            for frame in bs.read_capture(DEMO / name, rig)
        }
        (folder / "scenes.pickle").write_bytes(pickle.dumps(made))

    return pickle.loads((make_once(tmp_path_factory, "scenes", make) / "scenes.pickle").read_bytes())


@pytest.fixture(scope="session")
def belt(scenes: dict[str, Scene], rig: bs.Rig) -> bs.Belt:
    return bs.learn_belt([scenes["belt_empty"].depth], rig)
