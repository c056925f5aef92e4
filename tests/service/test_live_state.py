"""The live state: events, snapshots and bounded memory."""

from __future__ import annotations

import threading
from dataclasses import replace
from math import inf, nan

import cv2
import numpy as np

from beltscape.core.events import CameraHealth, FrameEvent, Maintenance
from beltscape.core.findings import Finding
from beltscape.core.frames import FrameSet
from beltscape.core.ledger import Totals
from beltscape.service.live_state import LiveState
from beltscape.service.settings import WebSettings
from beltscape.service.view_models import LatencyMeter, convert_to_8_bit, encode_thumbnail
from tests.service.feeder import CAMERAS, SimulatedPlant, SummingLedger


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0
        self.offset_s = 1_700_000_000.0

    def monotonic_s(self) -> float:
        return self.now_s

    def wall_ns(self) -> int:
        return int((self.now_s + self.offset_s) * 1e9)


def feed_live_state(frames: int, **settings) -> tuple[LiveState, SimulatedPlant, Clock]:
    clock = Clock()
    live_state = LiveState(WebSettings(**settings), monotonic_s=clock.monotonic_s, wall_ns=clock.wall_ns)
    plant = SimulatedPlant([live_state], SummingLedger())
    for _ in range(frames):
        clock.now_s += 0.2
        plant.step(clock.wall_ns())
    return live_state, plant, clock


def test_the_initial_state_is_unknown():
    snapshot = LiveState().take_snapshot()
    assert (snapshot.frame_age_s, snapshot.health_age_s) == (inf, inf)
    assert snapshot.record is None and snapshot.cameras == () and snapshot.alarms == ()
    assert np.isnan(snapshot.flow.volume_m3_h)
    assert LiveState().get_picture("cam1") is None


def test_snapshot_contains_the_events():
    live_state, plant, clock = feed_live_state(12)
    snapshot = live_state.take_snapshot()
    assert snapshot.frames.done == 12
    assert snapshot.totals == plant.ledger.totals
    assert [camera.name for camera in snapshot.cameras] == list(CAMERAS)
    assert 300 < snapshot.flow.volume_m3_h < 900
    assert snapshot.record == 12
    assert snapshot.frame_age_s == 0
    clock.now_s += 7
    assert live_state.take_snapshot().frame_age_s == 7


def test_points_stay_ordered_after_the_clock_is_set_back():
    live_state, plant, clock = feed_live_state(40)
    clock.offset_s -= 5
    for _ in range(10):
        clock.now_s += 0.3
        plant.step(clock.wall_ns())
    _, points = live_state.list_points()
    times = [point.wall_ms for point in points]
    assert times == sorted(set(times))
    count, new = live_state.list_points(live_state.list_points()[0] - 3)
    assert len(new) == 3 and new[-1] == points[-1] and count >= len(points)


def test_memory_is_bounded():
    live_state, _, _ = feed_live_state(3)
    for k in range(700):
        live_state.on_message(f"{k} " + "x" * 2000)
    assert len(live_state.take_snapshot().notes) == 50 and all(
        len(text) <= 500 for _, text in live_state.take_snapshot().notes
    )
    live_state.on_health({f"c{k}": CameraHealth(f"c{k}", "ok", 0, 0, 0, 0) for k in range(1000)})
    assert len(live_state.take_snapshot().cameras) == 64
    live_state.on_records(live_state.list_records() * 300, Totals())
    assert len(live_state.list_records()) == 600


def test_a_picture_is_encoded_once_and_small(monkeypatch):
    live_state, _, _ = feed_live_state(2, picture_px=100)
    made = []
    monkeypatch.setattr(
        "beltscape.service.live_state.encode_thumbnail", lambda *a: made.append(1) or encode_thumbnail(*a)
    )
    first = live_state.get_picture("cam2")
    assert first is live_state.get_picture("cam2") and made == [1]
    assert first is not None
    image = cv2.imdecode(np.frombuffer(first.data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert image is not None and max(image.shape[:2]) == 100


def test_deep_images_are_shifted_by_the_bits_in_use():
    ramp = np.linspace(0, 4095, 64).astype(np.uint16).reshape(8, 8)
    assert convert_to_8_bit(ramp).max() == 255
    assert convert_to_8_bit((ramp << 4).astype(np.uint16)).max() == 255
    assert convert_to_8_bit((ramp >> 4).astype(np.uint8)).max() == 255
    colour = np.dstack(
        [np.full((40, 60), 200, np.uint8), np.zeros((40, 60), np.uint8), np.zeros((40, 60), np.uint8)]
    )
    back = cv2.imdecode(np.frombuffer(encode_thumbnail(colour, 480), np.uint8), cv2.IMREAD_COLOR)
    assert back is not None and back[20, 30, 2] > 150 and back[20, 30, 0] < 60  # red stays red


def test_concurrent_readers_see_consistent_states():
    live_state, plant, clock = feed_live_state(5)
    errors: list[BaseException] = []
    stop = threading.Event()

    def read() -> None:
        try:
            mark = None
            while not stop.is_set():
                snapshot = live_state.take_snapshot()
                assert snapshot.totals.records <= plant.number
                mark, rows = live_state.get_belt(mark)
                assert rows is None or rows.counts.shape[1] == rows.x_mm.size
                live_state.list_points()
                live_state.list_records()
                live_state.get_picture("cam1")
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=read) for _ in range(4)]
    for thread in threads:
        thread.start()
    for _ in range(25):
        clock.now_s += 0.2
        plant.step(clock.wall_ns())
    stop.set()
    for thread in threads:
        thread.join()
    assert errors == []


def test_a_camera_that_is_lost_keeps_its_last_picture():
    live_state, _, _ = feed_live_state(2)
    image = np.full((4, 4), 7, np.uint8)
    live_state.on_frame(FrameEvent(FrameSet("late", {"cam1": image}), 3, 0, 0, 0.1, 0.5, 2000))
    assert live_state.take_snapshot().picture_frames["cam1"] == "late"
    assert live_state.take_snapshot().picture_frames["cam2"] == "000001"


def test_no_flow_is_shown_during_maintenance():
    live_state, *_ = feed_live_state(12)
    assert live_state.take_snapshot().flow.volume_m3_h > 0
    live_state.on_maintenance(Maintenance("cleaning", "ana", 1, 2))
    shown = live_state.take_snapshot()
    assert np.isnan(shown.flow.volume_m3_h) and shown.flow.standing == "missing"
    assert shown.maintenance is not None and shown.maintenance.reason == "cleaning"
    live_state.on_maintenance(None)
    assert live_state.take_snapshot().flow.volume_m3_h > 0


def test_a_check_keeps_its_newest_finding_that_was_made():
    live_state, _, clock = feed_live_state(1)
    sound = Finding("zero_shift", 0.3, 0.1, 2.0, "mm")
    live_state.on_findings([sound, Finding("lamp", nan, nan, 80.0, "%")])
    clock.now_s += 4
    live_state.on_findings(
        [Finding("zero_shift", nan, nan, 2.0, "mm"), Finding("dirt", 1.0, 0.1, 2.0, "%", "cam1")]
    )
    listed = live_state.list_checks()
    assert [(one.finding.check, one.age_s) for one in listed] == [
        ("dirt", 0.0),
        ("lamp", 4.0),
        ("zero_shift", 4.0),
    ]
    assert listed[2].finding == sound
    live_state.on_findings([Finding(f"check{k}", 1.0, 0.1, 2.0, "") for k in range(2000)])
    assert len(live_state.list_checks()) == 1000


def test_the_flow_is_known_while_no_record_can_be_stored():
    live_state, plant, clock = feed_live_state(20)
    last = live_state.list_records()[-1]
    before, records = live_state.take_snapshot(), len(live_state.list_records())
    for number in range(last.number + 1, last.number + 41):  # 8 s
        clock.now_s += 0.2
        live_state.on_frame(FrameEvent(FrameSet(str(number), {}), number, 0, 0, 0.1, 0.96, 1000.0))
        live_state.on_measured([replace(last, number=number)])
    now = live_state.take_snapshot()
    assert now.flow.volume_m3_h > 0 and now.flow.age_s == 0
    assert (now.totals, now.record, len(live_state.list_records())) == (before.totals, before.record, records)
    stored = [replace(last, number=number) for number in range(last.number + 1, last.number + 41)]
    live_state.on_records(stored, plant.ledger.totals)  # the lock is gone: each counts once
    again = live_state.take_snapshot()
    assert again.flow.volume_m3_h == now.flow.volume_m3_h
    assert again.record == last.number + 40


def test_the_flow_is_unknown_soon_after_the_last_depth_although_records_go_on():
    """The core camera fails over a slow belt: what was measured before leaves the view for many seconds."""
    live_state, plant, clock = feed_live_state(12)
    on_frame = live_state.on_frame
    live_state.on_frame = lambda event: on_frame(replace(event, coverage=0.0))
    for _ in range(20):
        clock.now_s += 0.2
        plant.step(clock.wall_ns())
    assert live_state.take_snapshot().record == 32
    flow = live_state.take_snapshot().flow
    assert np.isnan(flow.volume_m3_h) and flow.standing == "missing"


def test_values_of_rare_frames_last_longer():
    live_state, plant, clock = feed_live_state(2)
    assert live_state.take_snapshot().stale_s == 3.0
    for _ in range(10):
        clock.now_s += 5.0
        plant.step(clock.wall_ns())
    assert live_state.take_snapshot().stale_s == 15.0
    clock.now_s += 10.0
    assert live_state.take_snapshot().flow.volume_m3_h > 0


def test_latency_counts_from_a_records_frame_and_from_the_last_one_that_saw_its_belt():
    meter, view_mm = LatencyMeter(), 500.0
    for number in range(6):  # one frame set a second, each measured 0.5 s after it came
        meter.add_frame(str(number), 0.5, number + 0.5, 200.0 * number, view_mm)
    meter.add_record("0", 5.6)  # at 0 mm: that at 400 mm is the last to see its belt
    meter.add_record("another", 5.6)
    meter.add_frame("6", 0.25, 6.25, nan, view_mm)
    meter.add_record("6", 7.0)  # no position is known
    records, after_view, frames = (one.summarise() for one in (meter.records, meter.after_view, meter.frames))
    assert (records.records, records.worst_s, records.median_s) == (2, 5.6, 5.6)
    assert (after_view.records, after_view.median_s) == (1, 5.6 - 2)
    assert (frames.records, frames.median_s, frames.worst_s) == (7, 0.5, 0.5)


def test_a_frame_set_that_was_not_matched_keeps_what_was_measured_in_the_last_one():
    live_state, _, clock = feed_live_state(12)
    before, durations = live_state.take_snapshot(), live_state.durations.compute_cumulative()
    for number in range(1, 41):  # 8 s on a belt at rest
        clock.now_s += 0.2
        one = FrameEvent(
            FrameSet(f"r{number}", {}), 12, 0, 0, 0.001, 0.96, 0.0, repeated=number, is_repeat=True
        )
        live_state.on_frame(one)
    now = live_state.take_snapshot()
    assert (now.frames.repeated, now.frames.done) == (40, 12)
    assert now.frames.seconds == before.frames.seconds
    assert live_state.durations.compute_cumulative() == durations
    assert now.frames.speed_mm_s == 0.0
    assert now.frame_age_s == 0.0
