"""Frames side by side: the same results in the same order as one after the other, whatever happens to a frame."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.core.errors import OutputError, ReconstructionError
from beltscape.core.findings import Finding
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Silent
from beltscape.health.images.monitor import ImageMonitor
from beltscape.health.settings import HealthSettings
from beltscape.pipeline.reconstructing import match_ahead as ahead
from beltscape.pipeline.reconstructing.checked_matcher import CheckedDepth, CheckedMatcher
from beltscape.pipeline.reconstructing.frame_writer import Frame, FrameWriter
from beltscape.pipeline.reconstructing.reconstruction import reconstruct
from tests.synthetic.demo import DEMO, crop_demo_rig, read_cropped_frame, read_cropped_truth

RIG = crop_demo_rig()
TRUTH = read_cropped_truth("belt_loaded")


class CountingMatcher:
    """A matcher that returns the true depth, with σ that names the auxiliaries; it counts the frames at one time."""

    def __init__(self, names: tuple[str, ...], counts: list[int]) -> None:
        self.names, self._counts, self._lock, self._now = names, counts, threading.Lock(), 0

    def reconstruct(self, frame_set, reporter):
        del reporter
        with self._lock:
            self._now += 1
            self._counts.append(self._now)
        threading.Event().wait(0.02)  # long enough for another thread to start
        with self._lock:
            self._now -= 1
        if frame_set.images[RIG.core].mean() < 2:
            raise ReconstructionError(f"frame {frame_set.frame}: no surface found")
        sigma = np.full_like(TRUTH, 0.01 * len(self.names))
        return DepthMap(TRUTH, sigma, np.full(TRUTH.shape, 4, np.uint8), np.ones_like(TRUTH))


class Sequence(list[FrameSet]):
    """Frames in place of a source of a capture."""

    folder = DEMO


@pytest.fixture(scope="module")
def frame():
    return read_cropped_frame("belt_loaded")


@pytest.fixture(scope="module")
def frames(frame):
    """A sound frame, a dark one, one with a mirrored camera, one without an image of the core, a sound one."""
    dark = {name: np.ones_like(image) for name, image in frame.images.items()}
    mirrored = {**frame.images, "cam3": np.ascontiguousarray(frame.images["cam3"][:, ::-1])}
    headless = {name: image for name, image in frame.images.items() if name != RIG.core}
    images = [frame.images, dark, mirrored, headless, frame.images]
    return Sequence(replace(frame, frame=f"{i:03d}", images=each) for i, each in enumerate(images))


def run(frames, at_a_time):
    """Return the frames' names, σ, auxiliaries and faults, the warnings, and the most frames at one time."""
    counts: list[int] = []
    matcher = CheckedMatcher(
        RIG, RIG.auxiliaries, (570.0, 750.0), lambda names: CountingMatcher(names, counts)
    )
    monitor, reporter = ImageMonitor(RIG, HealthSettings(learning=False)), Silent()
    with ahead.open_threads(at_a_time) as pool:
        done = [
            (f.frame_set.frame, f.checked.depth.sigma_mm.tobytes(), f.checked.auxiliaries, f.checked.faults)
            for f in reconstruct(frames, matcher, monitor, reporter, pool, at_a_time)
        ]
    return done, reporter.warnings, max(counts)


@pytest.mark.thorough
def test_frames_matched_at_a_time_change_no_result_and_no_warning(frames):
    alone, two = run(frames, 1), run(frames, 2)
    assert two[:2] == alone[:2]
    assert [name for name, *_ in alone[0]] == ["000", "002", "004"]
    assert [len(names) for _, _, names, _ in alone[0]] == [4, 3, 4]
    assert (alone[2], two[2]) == (1, 2)


@pytest.mark.parametrize(
    ("cores", "frames", "size_px", "expected"),
    [
        (1, 9, (1224, 1024), (1, 1)),
        (2, 9, (1224, 1024), (2, 1)),
        (2, 1, (1224, 1024), (1, 2)),
        (8, 9, (1224, 1024), (2, 4)),
        (8, 9, (2448, 2048), (1, 8)),
    ],
)
def test_threads_fill_the_cores_and_memory_stays_bounded(monkeypatch, cores, frames, size_px, expected):
    monkeypatch.setattr(ahead, "count_usable_cores", lambda: cores)
    assert ahead.choose_threads(frames, size_px) == expected


def test_frames_that_are_no_longer_wanted_are_not_matched(frames):
    counts: list[int] = []
    matcher = CheckedMatcher(
        RIG, RIG.auxiliaries, (570.0, 750.0), lambda names: CountingMatcher(names, counts)
    )
    with ahead.open_threads(2) as pool:
        waiting = ahead.match_ahead(frames, matcher, pool, 2)
        next(waiting)
        waiting.close()
    assert len(counts) <= 3


def make_frame(frame, name):
    depth = CountingMatcher(RIG.auxiliaries, []).reconstruct(frame, Silent())
    finding = Finding("brightness", 1.0, 0.1, 2.0, "", "cam0")
    return Frame(replace(frame, frame=name), CheckedDepth(depth, None, RIG.auxiliaries, ()), (finding,))


def test_writer_keeps_the_order_and_refuses_what_cannot_be_written(frame, tmp_path):
    names = ["b", "a", "c"]
    with FrameWriter(tmp_path / "r", RIG, (RIG.core, *RIG.auxiliaries)) as writer:
        for name in names:
            writer.add(make_frame(frame, name))
        assert writer.finish() is None or (tmp_path / "r" / "regions.png").is_file()
    assert [document["frame"] for document in writer.documents] == names
    assert all((tmp_path / "r" / name / "depth.tiff").is_file() for name in names)
    (tmp_path / "r" / "d").write_text("a file where a folder must be")
    with (
        pytest.raises(OutputError, match="is a file, not a folder"),
        FrameWriter(tmp_path / "r", RIG, (RIG.core,)) as writer,
    ):
        writer.add(make_frame(frame, "d"))
        writer.finish()
