"""Fixtures: the demo's capture, smaller forms of it, and one run of the demo with three of its cameras."""

from __future__ import annotations

import contextlib
import io
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.once import make_once
from tests.synthetic.demo import DEMO, SCENES, crop_demo, write_demo


@pytest.fixture
def capture(tmp_path):
    """A function scene → a copy of it, to be damaged."""

    def copy(scene: str) -> Path:
        return Path(shutil.copytree(DEMO / scene, tmp_path / scene))

    return copy


@pytest.fixture
def run(capsys):
    """A function that runs the program: exit code, standard output, lines on standard error."""
    from beltscape.cli.main import main

    def call(*words: object) -> tuple[int, str, list[str]]:
        capsys.readouterr()
        try:
            code = main([str(word) for word in words])
        except SystemExit as stop:
            code = int(stop.code or 0)
        captured = capsys.readouterr()
        return code, captured.out, captured.err.splitlines()

    return call


@pytest.fixture(scope="session")
def small_demo(tmp_path_factory):
    """The demo's scenes in three cameras and half of the size, with truth/rig.json; nobody writes into it."""
    return make_once(tmp_path_factory, "small_demo", write_demo)


@pytest.fixture(scope="session")
def small_rig(small_demo):
    """The rig.json of ``small_demo``."""
    return small_demo / "truth" / "rig.json"


@pytest.fixture
def small_capture(small_demo, tmp_path):
    """A function scene → a copy of it in three cameras and half of the size, to be damaged."""

    def copy(scene: str) -> Path:
        return Path(shutil.copytree(small_demo / scene, tmp_path / scene))

    return copy


@pytest.fixture(scope="session")
def cropped(tmp_path_factory):
    """The middle of the loaded belt and the module in five cameras, with truth/rig.json; nobody writes into it."""
    return make_once(tmp_path_factory, "cropped", lambda folder: crop_demo(folder, ("belt_loaded", "module")))


@pytest.fixture(scope="session")
def cropped_rig(cropped):
    """The rig.json of ``cropped``."""
    return cropped / "truth" / "rig.json"


@pytest.fixture
def cropped_capture(cropped, tmp_path):
    """A function scene → a copy of the middle of its images, to be damaged."""

    def copy(scene: str) -> Path:
        return Path(shutil.copytree(cropped / scene, tmp_path / scene))

    return copy


@pytest.fixture(scope="session")
def demo_run(tmp_path_factory):
    """A run of ``demo`` by one method on three cameras: its folders ``capture`` and ``out``, and demo.json."""
    from beltscape.cli.main import main

    def make(folder: Path) -> None:
        write_demo(folder / "capture", scenes=(*SCENES, "calibration"), factor=1.0)
        with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(io.StringIO()) as printed:
            patch.setattr("beltscape.evaluate.demo.DATA", folder / "capture")
            patch.setattr("beltscape.evaluate.demo.METHODS", ("multiview",))
            assert main(["demo", "--out", str(folder / "out"), "--json"]) == 0
        (folder / "demo.json").write_text(printed.getvalue())

    return make_once(tmp_path_factory, "demo_run", make)


@pytest.fixture(scope="session")
def small_frames(small_demo, small_rig, tmp_path_factory):
    """Frame folders of the empty and the loaded belt: the true depth with noise, on the grid of small images."""
    from beltscape.core.depth import DepthMap
    from beltscape.files.images import read_image
    from beltscape.files.reconstruction import write_frame
    from beltscape.files.rig_json import read_rig
    from beltscape.files.tiff import read_float_tiff
    from beltscape.stereo.pointcloud import cloud_from_depth

    def make(out: Path) -> None:
        camera = read_rig(small_rig).core_camera
        for seed, scene in enumerate(("belt_empty", "belt_loaded")):
            truth = read_float_tiff(small_demo / "truth" / f"{scene}_depth.tiff")
            depth = truth + np.random.default_rng(seed).normal(0, 0.1, truth.shape).astype(np.float32)
            known = np.isfinite(depth)
            sigma = np.where(known, 0.1, np.nan).astype(np.float32)
            found = DepthMap(depth, sigma, np.where(known, 2, 0).astype(np.uint8), known.astype(np.float32))
            image = read_image(small_demo / scene / "cam0" / "000.png")
            cloud, preview = cloud_from_depth(found, camera, None), np.zeros((4, 4, 3), np.uint8)
            write_frame(out / scene / "000", found, cloud, preview, image)
            shutil.copy(small_rig, out / scene / "rig.json")

    return make_once(tmp_path_factory, "small_frames", make)


@pytest.fixture(scope="session")
def small_belt(small_frames, tmp_path_factory):
    """The belt.json of the empty belt's frame."""
    from beltscape.core.progress import Silent
    from beltscape.pipeline.measuring.belt import measure_empty_belt, write_belt_files

    def make(out: Path) -> None:
        write_belt_files(out / "belt.json", *measure_empty_belt(small_frames / "belt_empty", None, Silent()))

    return make_once(tmp_path_factory, "small_belt", make) / "belt.json"
