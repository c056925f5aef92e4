"""Frames matched on workers: the same bytes in every file as without workers, whatever happens to a worker."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import scale_rig
from beltscape.core.progress import Silent
from beltscape.files.images import read_image
from beltscape.files.rig_json import read_rig
from beltscape.kernels import load
from beltscape.kernels.cuda.emulated_device import is_emulation_built
from beltscape.pipeline.reconstructing import match_ahead, reconstruction
from beltscape.pipeline.reconstructing.frame_measurements import MeasuredDepth
from beltscape.pipeline.reconstructing.match_ahead import MatcherFactory, MatchTask
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.settings import MultiviewSettings
from beltscape.workers.call import Completed
from beltscape.workers.options import WorkerOptions
from tests.kernels.test_resident import same_bytes
from tests.optional import require
from tests.stereo.scenes import make_ring, patch, plane, quantise, render_images
from tests.synthetic.demo import DEMO, TRUE_RIG
from tests.thorough import list_cases
from tests.workers.cluster import start_cluster
from tests.workers.functions import KillOnce

RIG = scale_rig(read_rig(TRUE_RIG), 0.5)
RANGE_MM = (570.0, 750.0)
FACTORY = MatcherFactory(RIG, RANGE_MM, MultiviewSettings.preset("fast"))
FRAMES = ("000", "001", "002", "003")
"""The load, a frame with a mirrored camera, one without an image of the core, and the load in another light."""


PROCESSES, CLUSTER = WorkerOptions(workers=2), WorkerOptions(workers=2, address="auto")
WORKERS = list_cases([PROCESSES, CLUSTER], [PROCESSES])


@pytest.fixture(scope="module")
def cluster() -> Iterator[None]:
    """A local cluster that all tests of the file share."""
    yield from start_cluster()


@pytest.fixture
def workers(request: pytest.FixtureRequest) -> WorkerOptions:
    """Processes of this machine, or the cluster."""
    if request.param is CLUSTER:
        request.getfixturevalue("cluster")
    return request.param


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four frames: the cameras in use change after the second, the third cannot be matched."""
    folder = tmp_path_factory.mktemp("workers") / "capture"
    for camera in RIG.cameras:
        image = cv2.resize(
            read_image(DEMO / "belt_loaded" / camera / "000.png"),
            RIG.cameras[camera].size_px,
            interpolation=cv2.INTER_AREA,
        )
        mirrored = np.ascontiguousarray(image[:, ::-1]) if camera == "cam3" else image
        (folder / camera).mkdir(parents=True)
        for name, one in zip(FRAMES, (image, mirrored, image, image // 2), strict=True):
            cv2.imwrite(str(folder / camera / f"{name}.png"), one)
    for path in (folder / "cam4" / "003.png", folder / RIG.core / "002.png"):
        path.write_bytes(b"no image")
    return folder


def reconstruct(
    capture: Path, out: Path, options: WorkerOptions, **more: str
) -> tuple[dict[str, bytes], list[str]]:
    """Return the files of a reconstruction, and its warnings."""
    reporter = Silent()
    reconstruction.reconstruct_capture(
        capture, RIG, out, reporter, depth_range_mm=RANGE_MM, preset="fast", workers=options
    )
    files = {str(path.relative_to(out)): path.read_bytes() for path in out.rglob("*") if path.is_file()}
    return files, [line.replace(str(out), "") for line in reporter.warnings]


@pytest.fixture(scope="module")
def alone(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, bytes], list[str]]:
    """The files and warnings without workers."""
    return reconstruct(capture, tmp_path_factory.mktemp("alone"), WorkerOptions())


@pytest.mark.parametrize("workers", WORKERS, indirect=True, ids=str)
def test_files_and_warnings_are_those_without_workers(capture, alone, tmp_path, workers) -> None:
    files, warnings = reconstruct(capture, tmp_path, workers)
    assert sorted(files) == sorted(alone[0])
    assert [name for name in files if files[name] != alone[0][name]] == []
    assert sorted(warnings) == sorted(alone[1])  # images are read as many frames ahead as there are workers
    assert {"000/depth.tiff", "001/sigma.tiff", "003/depth.tiff", "reconstruction.json"} <= files.keys()
    assert any("002" in line and "going on without this frame" in line for line in warnings)


@pytest.mark.thorough
@pytest.mark.parametrize("workers", WORKERS, indirect=True, ids=str)
def test_a_killed_worker_repeats_its_frame_only(capture, alone, tmp_path, monkeypatch, workers) -> None:
    marks = tmp_path / "marks"
    marks.mkdir()
    opened = match_ahead.open_pool
    monkeypatch.setattr(
        match_ahead,
        "open_pool",
        lambda function, *others: opened(KillOnce(function, str(marks)), *others),
    )
    files, warnings = reconstruct(capture, tmp_path / "r", workers)
    assert [name for name in alone[0] if files[name] != alone[0][name]] == []
    assert sorted(warnings) == sorted(alone[1])
    assert sorted(path.name for path in marks.iterdir()) == [name for name in FRAMES if name != "002"]


@pytest.mark.thorough
@pytest.mark.parametrize("elsewhere", list_cases(["nothing", "another_frame"], ["another_frame"]))
@pytest.mark.usefixtures("cluster")
def test_images_are_sent_to_workers_that_do_not_see_them(capture, tmp_path, elsewhere: str) -> None:
    other = {name: capture / name / "003.png" for name in ("cam0", "cam1", "cam2", "cam3")}
    files = {name: tmp_path / name for name in other} if elsewhere == "nothing" else other
    frame = next(iter(reconstruction.open_capture(capture, RIG, Silent())))
    frame = replace(frame, images={name: frame.images[name] for name in files})
    reporter = Silent()
    with match_ahead.open_workers(FACTORY, CLUSTER, lambda _: files, reporter) as workers:
        pending = workers.submit(frame, ("cam1", "cam2", "cam3"), lambda: pytest.fail("made here"))
        assert pending.task.files.keys() == files.keys()
        first = require(pending.result()).depth
        later = workers.submit(frame, ("cam1", "cam2", "cam3"), lambda: pytest.fail("made here"))
        assert not later.task.files
        assert first.depth_mm.tobytes() == require(later.result()).depth.depth_mm.tobytes()
    here = FACTORY(("cam1", "cam2", "cam3")).reconstruct(frame, reporter)
    assert first.depth_mm.tobytes() == here.depth_mm.tobytes()
    assert not reporter.warnings


@dataclass(frozen=True)
class DeadPool:
    """Workers that do not survive a frame."""

    workers: int

    def done(self) -> bool:
        """Return that it has ended."""
        return True

    def submit(self, task: MatchTask, name: str) -> DeadPool:
        """Take a frame."""
        del task, name
        return self

    def wait(self, pending: Sequence[DeadPool]) -> list[DeadPool]:
        """Return the tasks, all of which have ended."""
        return [*pending]

    def result(self) -> Completed[MeasuredDepth | None]:
        """Return the workers' death."""
        assert self.done()
        return Completed(0, None, "its worker died 11 times (WorkerCrashedError)", "", 0.0, 0.0)


def test_frames_ahead_keep_every_worker_busy_within_the_memory() -> None:
    workers = match_ahead.MatchWorkers(DeadPool(64), FACTORY, lambda _: {}, Silent(), sends_images=True)
    assert workers.count_frames_ahead((612, 512), 5) == 128
    assert workers.count_frames_ahead((4096, 3000), 5) * 4096 * 3000 * 18 <= 4 << 30


def test_a_frame_that_no_worker_survives_is_matched_here(capture) -> None:
    reporter = Silent()
    frame = next(iter(reconstruction.open_capture(capture, RIG, Silent())))
    workers = match_ahead.MatchWorkers(DeadPool(2), FACTORY, lambda _: {}, reporter, sends_images=True)
    assert workers.submit(frame, RIG.auxiliaries, lambda: pytest.fail("made here")).result() is None
    assert reporter.warnings == [
        "frame 000: its worker died 11 times (WorkerCrashedError); it is matched by this process"
    ]


@pytest.mark.thorough
@pytest.mark.skipif(not is_emulation_built(), reason="the emulated GPU is not built")
def test_each_of_two_processes_opens_the_gpu_and_gives_the_bytes_of_one(monkeypatch) -> None:
    rig, solids = make_ring((0, 180), size_px=(48, 36)), (plane(760), patch(680, (-120, 120), (-100, 100)))
    frames = [
        FrameSet(
            str(seed),
            {name: quantise(image) for name, image in render_images(rig, solids, noise=1, seed=seed).items()},
        )
        for seed in range(4)
    ]
    factory = MatcherFactory(rig, (620.0, 820.0), MultiviewSettings.preset("fast"))
    monkeypatch.setenv("BELTSCAPE_KERNELS", "emulated")
    auxiliaries = tuple(name for name in rig.cameras if name != rig.core)
    with match_ahead.open_workers(factory, PROCESSES, lambda _: {}, Silent()) as workers:
        pending = [workers.submit(frame, auxiliaries, lambda: factory(auxiliaries)) for frame in frames]
        found = [each.result() for each in pending]
    alone, kernels = MultiviewSettings.preset("fast"), load("emulated")
    matcher = MultiviewReconstructor(rig, (620.0, 820.0), alone, kernels=kernels)
    for frame, each in zip(frames, found, strict=True):
        assert each is not None
        assert each.gpu_failure == ""
        assert same_bytes(each.depth, matcher.reconstruct(frame, Silent()))
