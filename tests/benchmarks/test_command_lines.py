"""The command lines of the benchmarks that print their figures: each runs, on the least input."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import io
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from beltscape.core.geometry.rig import scale_rig
from beltscape.core.progress import Silent
from beltscape.files.images import read_image
from beltscape.files.rig_json import read_rig, write_rig
from beltscape.kernels import load
from beltscape.kernels.cuda.emulated_device import is_emulation_built
from tests.docs.program import parser_of
from tests.synthetic.demo import DEMO, TRUE_RIG

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
CAMERAS = ("cam0", "cam1", "cam2")


@pytest.fixture(autouse=True)
def _path(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))


@pytest.fixture
def capture(tmp_path) -> Path:
    """One frame of the empty belt from three cameras, a quarter of the demo's pixels, and ``rig.json`` beside it."""
    rig = scale_rig(read_rig(TRUE_RIG), 0.5)
    cameras, poses = ({name: given[name] for name in CAMERAS} for given in (rig.cameras, rig.cam_from_core))
    rig = replace(rig, cameras=cameras, cam_from_core=poses)  # pyrefly: ignore[bad-argument-type]
    write_rig(tmp_path / "rig.json", rig)
    for name in CAMERAS:
        image = read_image(DEMO / "belt_empty" / name / "000.png")
        (tmp_path / "capture" / name).mkdir(parents=True)
        small = cv2.resize(image, rig.cameras[name].size_px, interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(tmp_path / "capture" / name / "000.png"), small)
    return tmp_path / "capture"


def test_speed_of_the_matcher(capture, monkeypatch, capsys):
    speed = importlib.import_module("matching.speed")
    called: list[list[str]] = []
    monkeypatch.setattr(subprocess, "run", lambda words, **_: called.append(words))
    words = [str(capture), "--rig", str(capture.parent / "rig.json"), "--runs", "1", "--frames", "2"]
    monkeypatch.setattr(sys, "argv", ["speed.py", *words])
    threads = cv2.getNumThreads()
    speed.main()
    cv2.setNumThreads(threads)
    said = capsys.readouterr().out
    assert "fast / bare SGBM: " in said
    assert "two cores / one core: " in said
    assert len(called) == 2
    for _, _, program, command, *rest in called:
        assert program == "beltscape"
        assert parser_of(command).parse_args(rest).rig


def test_roofline_of_the_kernels(capture, monkeypatch, capsys):
    roofline = importlib.import_module("roofline")
    for name, least in (("_RUNS", 1), ("_COPY_BYTES", 1 << 16), ("_PRODUCT", 16)):
        monkeypatch.setattr(roofline, name, least)
    words = [str(capture), "--rig", str(capture.parent / "rig.json"), "--preset", "fast"]
    monkeypatch.setattr(sys, "argv", ["roofline.py", *words])
    roofline.main()
    said = capsys.readouterr().out
    assert "| `sweep_and_aggregate` |" in said
    assert "| frame |" in said


def test_the_page_of_graphics_processors(capture, monkeypatch, tmp_path):
    gpu = importlib.import_module("gpu")
    monkeypatch.setattr(importlib.import_module("roofline"), "_RUNS", 1)
    page = tmp_path / "GPU.md"
    words = [str(capture), "--rig", str(capture.parent / "rig.json"), "--preset", "fast", "--out", str(page)]
    monkeypatch.setattr(sys, "argv", ["gpu.py", *words])
    gpu.main()
    text = page.read_text()
    assert "**Compiled and emulated, not run**" in text
    assert "preset `fast`" in text
    assert "| `sweep_and_aggregate` | GPU | 1 |" in text
    assert "| `propagate` | GPU |" in text
    assert "*processor*" not in text
    assert "| where each call copies its arrays | " in text


@pytest.mark.thorough
def test_a_frame_on_the_emulated_gpu_is_measured_and_is_that_of_the_processor(capture):
    gpu = importlib.import_module("gpu")
    if not is_emulation_built():
        pytest.skip("the emulated GPU is not built")
    rig = scale_rig(read_rig(capture.parent / "rig.json"), 0.5)
    write_rig(capture.parent / "rig.json", rig)
    for path in capture.glob("*/000.png"):
        size = rig.cameras[path.parent.name].size_px
        cv2.imwrite(str(path), cv2.resize(read_image(path), size, interpolation=cv2.INTER_AREA))
    problem = gpu.read_problem(capture, capture.parent / "rig.json", "fast")
    measured = gpu.measure_device(gpu.find_device("emulated"), problem, runs=1)
    assert measured.far_share == measured.only_one_share == 0
    assert {"sweep_and_aggregate", "normal_equations", "propagate"} <= set(measured.call_s)
    assert {"sweep_planes", "aggregate_direction", "sum_equations"} <= set(measured.launch_s)
    assert measured.is_repeatable
    text = gpu.format_page("a frame", gpu.count_traffic(problem), [measured])
    assert "Measured on emulated." in text
    assert "| `sweep_planes` | " in text


def test_measurements_of_a_gpu_are_written_as_they_are():
    gpu, measure, peers = (importlib.import_module(name) for name in ("gpu", "gpu_measure", "gpu_peers"))
    work = {"warp": importlib.import_module("roofline").Work(3, 0.0, 3_350_000, 1e6)}
    rows = [
        peers.MatcherRow("Beltscape, GPU", (1000, 1000), 4, 100, 0.004, 0.05, 0.9),
        peers.MatcherRow("slow", (1000, 1000), 4, 128, 0.5, None, 0.5),
    ]
    name = "NVIDIA H100 80GB HBM3, driver 580"
    measured = measure.Measured(
        name, "5 cameras", 0.005, {"warp": 2e-6, "gather": 1e-3}, {"warp_view": 1e-3}, 0.0001, 0.0, True, 2 << 30,
        {1: 200.0, 2: 250.0}, 1.5, rows, work, "OpenCV 5 finds no GPU", 15,
    )  # fmt: skip
    text = gpu.format_page("a frame", measure.FrameTraffic(work, 10, 2, 3), [measured])
    assert f"Measured on {name}." in text
    assert "takes 5.0 ms" in text
    assert "it runs 15 graphs." in text
    assert "libSGM's kernels, is not beside them: OpenCV 5 finds no GPU." in text
    assert "It takes 1.50 J of the GPU." in text
    assert "0.0100% are further than 0.001 mm" in text
    assert "| Beltscape, GPU | 5 × 1000 × 1000 | 100 | 4.0 | 250.0 | 100.0 | 0.050 | 90.0% |" in text
    assert "| slow | 5 × 1000 × 1000 | 128 | 500.0 | 2.0 | 1.0 | – | 50.0% |" in text
    assert text.index("Beltscape, GPU") < text.index("| slow")
    assert "| `warp` | 0.002 | 50.0% |" in text  # 1 µs by the H100's 3350 GB/s
    assert "| `gather` | 1.000 | – |" in text
    assert "not run" not in text


def test_other_matchers_are_measured_on_the_same_pairs(capture, monkeypatch):
    peers, measure = (importlib.import_module(name) for name in ("gpu_peers", "gpu_measure"))
    problem = measure.read_problem(capture, capture.parent / "rig.json", "fast")
    pairs = peers.rectify_pairs(problem.rig, problem.frame_set, problem.near_far_mm)
    assert "was built without CUDA's stereo matching" in peers.explain_missing(pairs)
    size_px = problem.rig.core_camera.size_px
    true_mm = problem.make_matcher(load()).reconstruct(problem.frame_set, Silent()).depth_mm
    monkeypatch.setattr(cv2, "cuda_GpuMat", np.asarray, raising=False)
    monkeypatch.setattr(cv2, "cuda", FakeCuda(cv2.StereoSGBM.create(0, 256, 3, 72, 288)))
    rows = peers.measure_others(pairs, size_px, true_mm)
    assert [row.name for row in rows] == [
        "OpenCV SGBM, processor", "OpenCV CUDA SGM (libSGM's kernels), GPU"
    ]  # fmt: skip
    for row in rows:
        assert row.pairs == len(pairs) == len(problem.rig.auxiliaries)
        assert row.size_px == size_px
        assert row.error_mm is not None
        assert row.error_mm < 5
        assert row.measured_share > 0.3
        assert row.evaluations_per_s > 0
    assert rows[1].disparities in peers.CUDA_DISPARITIES


@pytest.mark.parametrize("preset", ["fast", "standard"])
def test_a_frame_copies_its_images_and_its_depth_and_little_else(capture, preset):
    measure = importlib.import_module("gpu_measure")
    problem = measure.read_problem(capture, capture.parent / "rig.json", preset)
    width, height = problem.rig.core_camera.size_px
    traffic = measure.count_traffic(problem)
    images, depth = len(problem.rig.cameras), 13  # bytes a pixel
    assert images + depth < (traffic.up + traffic.down) / (width * height) < 5 * (images + depth)


class FakeCuda:
    """OpenCV's module for CUDA with SGBM of the processor in the place of its SGM."""

    def __init__(self, sgbm: cv2.StereoSGBM) -> None:
        self._sgbm = sgbm

    def getCudaEnabledDeviceCount(self) -> int:  # noqa: N802
        return 1

    def createStereoSGM(self, least: int, disparities: int) -> FakeCuda:  # noqa: N802
        assert (least, disparities % 64) == (0, 0)
        return self

    def compute(self, left: np.ndarray, right: np.ndarray) -> Downloaded:
        return Downloaded(self._sgbm.compute(left, right))


class Downloaded:
    """A result on the GPU."""

    def __init__(self, values: np.ndarray) -> None:
        self._values = values

    def download(self) -> np.ndarray:
        return self._values


@pytest.mark.thorough
def test_the_script_of_graphics_processors_runs_to_its_end_without_one(capture, tmp_path):
    programs = tmp_path / "bin"
    programs.mkdir()
    for name, text in (("nvidia-smi", "exit 3"), ("compute-sanitizer", 'shift 4; exec "$@"')):
        (programs / name).write_text(f"#!/bin/sh\n{text}\n")
        (programs / name).chmod(0o755)
    environment = {**os.environ, "PATH": f"{programs}:{os.environ['PATH']}"}
    done = subprocess.run(
        ["sh", str(BENCHMARKS / "gpu.sh"), str(tmp_path / "out"), str(capture), str(capture.parent / "rig.json")],
        env=environment | {"VENV": sys.prefix, "DEVICE": "none"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    steps = [line.split(" after")[0] for line in (tmp_path / "out" / "steps.txt").read_text().splitlines()]
    packages = int(importlib.util.find_spec("cuda") is None)  # the extra gpu, which this machine may lack
    checks = dict.fromkeys(("check", "measure", "tests", "memcheck", "racecheck"), packages)
    checks |= {"measure": 0, "tests": 0}
    assert steps == ["gpu: exit code 3", *(f"{name}: exit code {code}" for name, code in checks.items())]
    assert done.returncode == 1, "a step failed, and the others ran all the same"
    files = {path.name: path.read_text() for path in (tmp_path / "out").iterdir()}
    assert sorted(files) == ["GPU.md", "gpu.log", "steps.txt"]
    assert all(str(tmp_path / "out" / name) in done.stdout for name in files)
    assert "**Compiled and emulated, not run**" in files["GPU.md"]
    assert "=== racecheck\n" in files["gpu.log"]


def test_the_limits_of_the_script_of_graphics_processors_add_up_to_eight_minutes():
    text = (BENCHMARKS / "gpu.sh").read_text()
    (limit,) = map(int, re.findall(r"^limit=(\d+)", text, re.MULTILINE))
    steps = {name: int(seconds) for name, seconds in re.findall(r'step "?\$?(\w+)"? (\d+) ', text)}
    assert limit == sum(steps.values()) + steps["tool"] == 470  # a tool is one of two
    with_wheels = text.partition('if [ -n "${WHEELS:-}" ]')[2].partition("fi\n")[0]
    assert "--no-index" in with_wheels


def test_the_check_before_a_measurement_names_what_is_missing_and_compares_each_kernel(monkeypatch, capsys):
    check = importlib.import_module("gpu_check")
    monkeypatch.setattr(sys, "argv", ["gpu_check.py", "--device", "none"])
    monkeypatch.setattr(
        check, "MODULES", ("gpu", "pytest", "hypothesis")
    )  # the extra gpu may not be installed
    assert check.main() == 0
    monkeypatch.setattr(check, "MODULES", ("gpu", "no_such_package.part", "cuda.core"))
    monkeypatch.setitem(sys.modules, "cuda.core", None)
    assert check.main() == 1
    assert capsys.readouterr().err == (
        "missing: no_such_package, cuda.core; put their wheels, of this state, into WHEELS\n"
    )

    def fail(kernels):
        raise ValueError(f"no result of {kernels.name}")

    cases = {"warp": lambda kernels: [np.full(1000, kernels.name == "native")], "fails": fail}
    monkeypatch.setattr("beltscape.kernels.self_test.CASES", cases)
    monkeypatch.setattr("beltscape.kernels.load", lambda name: SimpleNamespace(name=name, failure=None))
    assert check.compare_cases("emulated") == 2
    said = capsys.readouterr().out
    assert "warp: 100.0000% of the values differ" in said
    assert "fails: ValueError: no result of emulated" in said


@pytest.mark.parametrize(("wheels", "failing"), [("", "environment"), ("none", "build")])
def test_the_script_of_graphics_processors_stops_where_it_cannot_build(tmp_path, wheels, failing):
    done = subprocess.run(
        ["sh", str(BENCHMARKS / "gpu.sh"), str(tmp_path / "out"), "capture", "rig.json"],
        env={"PATH": "/usr/bin:/bin", "PYTHON": "false", "WHEELS": wheels},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 1
    *steps, last = done.stdout.splitlines()
    assert last == f"nothing is measured: the packages are not there, see {tmp_path}/out/gpu.log"
    assert [step.partition(":")[0] for step in steps] == [failing]
    assert (tmp_path / "out" / "steps.txt").read_text().splitlines() == steps


class Served:
    """In place of the process that serves: its command, and the figures that it prints."""

    def __init__(self, command: list[str], **_: object) -> None:
        assert command[:3] == [sys.executable, "-m", "protocols.load"]
        self.words = command[2:]

    def communicate(self) -> tuple[str, None]:
        said = io.StringIO()
        with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(said):
            patch.setattr(sys, "argv", self.words)
            importlib.import_module("protocols.load").main()
        return said.getvalue(), None


def test_load_of_the_protocols(monkeypatch, capsys):
    load = importlib.import_module("protocols.load")
    for name, value in (("CASES", {"none": ()}), ("_WARM_S", 0.1), ("find_broker", lambda: "not needed")):
        monkeypatch.setattr(load, name, value)
    monkeypatch.setattr(load.subprocess, "Popen", Served)
    monkeypatch.setattr(sys, "argv", ["load.py", "--seconds", "0.3", "--rounds", "1"])
    load.main()
    assert "| none | 0." in capsys.readouterr().out


@pytest.mark.thorough
def test_fused_belt(tmp_path, monkeypatch, capsys):
    benchmark = importlib.import_module("fused_belt")
    least = benchmark.MovingHeap(5, 2, (20, 79, 50), 40, speed_mm_s=1500, scale=0.125)
    monkeypatch.setattr(benchmark, "HEAPS", {"least": least})
    monkeypatch.setattr(sys, "argv", ["fused_belt.py", str(tmp_path), "--heaps", "least"])
    benchmark.main()
    rows = [line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines()[2:]]
    assert [row[:3] for row in rows] == [["least", "3", way] for way in ("single", "fused", "continued")]
    single, fused, continued = (float(row[4].rstrip("%")) for row in rows)
    assert 0 < single < fused < continued < 100


@pytest.fixture
def scenes(tmp_path) -> Path:
    """A file of one small scene for the benchmarks of other plants."""
    (tmp_path / "scenes.toml").write_text(
        '[plants.paper]\nkind = "belt_loaded"\nseed = 1\nrig = { seed = 2, auxiliaries = 2, scale = 0.125 }\n'
        "heap = { rocks = 300 }\n[scenes.small]\n",
        encoding="utf-8",
    )
    return tmp_path / "scenes.toml"


@pytest.mark.thorough
def test_other_plants_by_a_stricter_confidence(scenes, monkeypatch, capsys):
    benchmark = importlib.import_module("axes")
    monkeypatch.setattr(benchmark, "SCENES", scenes)
    words = ["axes.py", "--scenes", "small", "--presets", "fast", "--cache", str(scenes.parent)]
    shares: list[list[float]] = []
    for least in ([], ["--least-confidence", "0.95"]):
        monkeypatch.setattr(sys, "argv", [*words, *least])
        benchmark.main()
        row = capsys.readouterr().out.splitlines()[2].strip("| ").split(" | ")
        assert row[:2] == ["fast", "small"]
        shares.append([float(row[at].rstrip("%")) for at in (2, 4)])
    (within, gross), (strict_within, strict_gross) = shares
    assert 0 < strict_within < within
    assert strict_gross < gross


def test_sets_of_networks_on_other_plants(scenes, monkeypatch, capsys):
    """A folder without networks leaves those that ship, so both rows hold the same shares."""
    monkeypatch.setattr(importlib.import_module("axes"), "SCENES", scenes)
    words = ["--scenes", "small", "--preset", "fast", "--gross", "0.02", "0.1", "--cache", str(scenes.parent)]
    (scenes.parent / "none").mkdir()
    monkeypatch.setattr(sys, "argv", ["networks.py", str(scenes.parent / "none"), *words])
    importlib.import_module("networks").main()
    head, _, shipped, same = capsys.readouterr().out.splitlines()
    assert head == "| scene | networks | < 1 mm at 2.0% gross | < 1 mm at 10.0% gross |"
    rows = [row.strip("| ").split(" | ") for row in (shipped, same)]
    assert [row[1] for row in rows] == ["shipped", "none"]
    assert rows[0][2:] == rows[1][2:]
    strict, mild = (float(share.rstrip("%")) for share in rows[0][2:])
    assert 0 < strict < mild


@pytest.mark.thorough
def test_flow_over_other_plants(scenes, monkeypatch, capsys):
    benchmark = importlib.import_module("axes_flow")
    monkeypatch.setattr(benchmark, "SCENES", scenes)
    words = ["--scenes", "small", "--presets", "fast", "--cache", str(scenes.parent)]
    monkeypatch.setattr(sys, "argv", ["axes_flow.py", *words])
    benchmark.main()
    row = capsys.readouterr().out.splitlines()[2].strip("| ").split(" | ")
    error, sigma = (float(part.split("%")[0]) for part in row[3].split(" ± "))
    assert row[:2] == ["fast", "small"]
    assert abs(error) < 3 * sigma


@pytest.mark.thorough
def test_fused_lumps(tmp_path, monkeypatch, capsys):
    """The lumps of a simulated moving belt: pixels find more than cells of 4 mm, and no lump counts twice."""
    benchmark = importlib.import_module("fused_lumps")
    heaps = importlib.import_module("fused_belt")
    least = heaps.MovingHeap(5, 2, (20, 79, 50), 40, speed_mm_s=1500, scale=0.125)
    for module in (benchmark, heaps):
        monkeypatch.setattr(module, "HEAPS", {"least": least})
    monkeypatch.setattr(sys, "argv", ["fused_lumps.py", str(tmp_path), "--heaps", "least"])
    benchmark.main()
    rows = [line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines()[2:]]
    assert [row[1] for row in rows] == ["fullest frame", "all frames summed", "fused, 4 mm", "fused, 1 px"]
    _, summed, coarse, fine = rows
    assert int(fine[2]) < int(summed[2])
    assert float(coarse[4].rstrip("%")) <= float(fine[4].rstrip("%"))
    assert float(fine[4].rstrip("%")) > 30
    assert float(fine[5].rstrip("%")) < 40
