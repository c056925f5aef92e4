"""The metrics endpoint: the figures of the page in Prometheus's text format 0.0.4, by its own library."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import inf, isfinite, isnan
from typing import Literal, get_args

from fastapi import APIRouter, Depends, Request, Response
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4
from prometheus_client.registry import Collector

from beltscape import __version__
from beltscape.core.alarm_catalogue import DISK_FULL
from beltscape.core.events import CameraState
from beltscape.service.access import User, require_role
from beltscape.service.api.common import AppContext, describe_refusals
from beltscape.service.live_state import LiveState
from beltscape.service.view_models import DURATION_BOUNDS_S, DurationHistogram, Snapshot

MEDIA_TYPE = CONTENT_TYPE_PLAIN_0_0_4
_Labels = Mapping[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class SnapshotCollector(Collector):
    """Collector of one snapshot's figures; unknown ones (NaN) are left out."""

    live_state: LiveState
    snapshot: Snapshot

    def collect(self) -> Iterator[Metric]:
        """Yield every metric."""
        yield from _list_flow(self.snapshot)
        yield from _list_totals(self.snapshot)
        yield from _list_frames(self.live_state, self.snapshot)
        yield from _list_cameras(self.snapshot)
        yield from _list_alarms(self.snapshot)
        yield from _list_checks(self.live_state)
        yield _make_gauge(
            "maintenance", "1 during maintenance.", float(self.snapshot.maintenance is not None)
        )


def format_metrics(live_state: LiveState, snapshot: Snapshot) -> str:
    """Return all metrics as text."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(SnapshotCollector(live_state, snapshot))
    return generate_latest(registry).decode()


def _make_gauge(name: str, help_text: str, value: float) -> Metric:
    return _make_labelled(name, "gauge", help_text, [({}, value)])


def _make_counter(name: str, help_text: str, value: float) -> Metric:
    return _make_labelled(name, "counter", help_text, [({}, value)])


def _make_labelled(
    name: str,
    kind: Literal["gauge", "counter"],
    help_text: str,
    samples: Iterable[tuple[_Labels, float]],
) -> Metric:
    """Return a metric with its samples; those that are NaN are left out."""
    make = GaugeMetricFamily if kind == "gauge" else CounterMetricFamily
    metric = make(f"beltscape_{name}", help_text)
    for labels, value in samples:
        if not isnan(value):
            metric.add_sample(f"beltscape_{name}", dict(labels), value)
    return metric


def _list_flow(snapshot: Snapshot) -> list[Metric]:
    flow = snapshot.flow
    return [
        _make_labelled("info", "gauge", "Version of the running program.", [({"version": __version__}, 1)]),
        _make_gauge(
            "flow_cubic_metres_per_hour",
            "Volume flow over the last seconds of belt travel.",
            flow.volume_m3_h,
        ),
        _make_gauge(
            "flow_sigma_cubic_metres_per_hour", "One standard deviation of the volume flow.", flow.sigma_m3_h
        ),
        _make_gauge(
            "flow_tonnes_per_hour", "Mass flow; absent where no bulk density is known.", flow.mass_t_h
        ),
        _make_gauge("load_area_square_metres", "Mean cross-section of the load.", flow.area_mm2 * 1e-6),
        _make_gauge("belt_speed_metres_per_second", "Speed of the belt.", snapshot.frames.speed_mm_s * 1e-3),
        _make_gauge("flow_age_seconds", "Since the last measured record; +Inf before the first.", flow.age_s),
        _make_gauge("strip_coverage_ratio", "Share of the belt that was measured, 0..1.", flow.coverage),
    ]


def _list_totals(snapshot: Snapshot) -> list[Metric]:
    totals = snapshot.totals
    standings = (("valid", totals.valid_mm), ("degraded", totals.degraded_mm), ("missing", totals.missing_mm))
    belt = [({"standing": name}, length_mm * 1e-3) for name, length_mm in standings]
    return [
        _make_counter("volume_cubic_metres_total", "Volume that passed.", totals.volume_mm3 * 1e-9),
        _make_gauge(
            "volume_sigma_cubic_metres",
            "One standard deviation of the volume that passed.",
            totals.sigma_mm3 * 1e-9,
        ),
        _make_counter(
            "mass_tonnes_total",
            "Mass that passed; absent where a bulk density was not known.",
            totals.mass_kg * 1e-3,
        ),
        _make_labelled("belt_metres_total", "counter", "Belt that passed, by how it is counted.", belt),
        _make_counter("records_total", "Entries of the ledger.", totals.records),
    ]


def _list_frames(live_state: LiveState, snapshot: Snapshot) -> list[Metric]:
    frames = snapshot.frames
    return [
        _make_counter("frame_sets_total", "Frame sets measured since the start.", frames.done),
        _make_counter(
            "frame_sets_dropped_total",
            "Frame sets left out since the start, newer ones being there.",
            frames.dropped,
        ),
        _make_counter(
            "frame_sets_repeated_total",
            "Frame sets of a belt at rest or creeping that showed what the last one showed, and were not matched.",
            frames.repeated,
        ),
        _make_gauge(
            "capacity_frame_sets_per_second",
            "Frame sets that the computer can measure in a second.",
            frames.capacity.sets_per_s,
        ),
        _make_gauge(
            "capacity_belt_speed_metres_per_second",
            "Speed of the belt up to which two frame sets show every millimetre.",
            frames.capacity.speed_mm_s * 1e-3,
        ),
        _make_gauge("frame_sets_waiting", "Frame sets in the queue.", frames.waiting),
        _make_gauge(
            "frame_coverage_ratio", "Share of the last frame that was measured, 0..1.", frames.coverage
        ),
        _make_gauge(
            "frame_age_seconds", "Since the last frame set; +Inf before the first.", snapshot.frame_age_s
        ),
        _make_histogram(
            "processing_seconds", "From the last image's arrival to its measurement.", live_state.durations
        ),
        _make_histogram(
            "record_latency_seconds",
            "From the last image's arrival to its record being stored and passed on.",
            live_state.latency.histogram,
        ),
    ]


def _make_histogram(name: str, help_text: str, histogram: DurationHistogram) -> Metric:
    counts, seconds = histogram.compute_cumulative()
    buckets = [
        (f"{bound:g}" if isfinite(bound) else "+Inf", float(n))
        for bound, n in zip((*DURATION_BOUNDS_S, inf), counts, strict=True)
    ]
    return HistogramMetricFamily(f"beltscape_{name}", help_text, buckets, seconds)


def _list_cameras(snapshot: Snapshot) -> list[Metric]:
    cameras = snapshot.cameras
    states = [
        ({"camera": one.name, "state": state}, float(one.state == state))
        for one in cameras
        for state in get_args(CameraState)
    ]
    each = [({"camera": one.name}, one) for one in cameras]
    return [
        _make_labelled("camera_state", "gauge", "1 at the state the camera is in.", states),
        _make_labelled(
            "camera_images_total",
            "counter",
            "Images taken since the start.",
            [(at, one.frames) for at, one in each],
        ),
        _make_labelled(
            "camera_missed_total",
            "counter",
            "Trigger instants without an image.",
            [(at, one.missed) for at, one in each],
        ),
        _make_labelled(
            "camera_rate_hertz", "gauge", "Images per second.", [(at, one.rate_hz) for at, one in each]
        ),
        _make_labelled(
            "camera_skew_seconds",
            "gauge",
            "Last image against the core's.",
            [(at, one.skew_ms * 1e-3) for at, one in each],
        ),
    ]


def _list_alarms(snapshot: Snapshot) -> list[Metric]:
    on = [
        ({"alarm": one.name, "severity": one.severity}, float(one.state in ("raised", "acknowledged")))
        for one in snapshot.alarms
    ]
    new = [
        ({"alarm": one.name, "severity": one.severity}, float(one.state in ("raised", "gone")))
        for one in snapshot.alarms
    ]
    disk = any(one.name == DISK_FULL and one.state in ("raised", "acknowledged") for one in snapshot.alarms)
    return [
        _make_labelled("alarm_active", "gauge", "1 while the alarm's condition holds and it is shown.", on),
        _make_labelled("alarm_unacknowledged", "gauge", "1 while nobody has acknowledged it.", new),
        _make_gauge("disk_trouble", "1 while the history cannot be written.", float(disk)),
    ]


def _list_checks(live_state: LiveState) -> list[Metric]:
    checks = live_state.list_checks()
    labels = [{"check": one.finding.check, "subject": one.finding.subject} for one in checks]
    units = [{**label, "unit": one.finding.unit} for label, one in zip(labels, checks, strict=True)]
    each = list(zip(labels, checks, strict=True))
    return [
        _make_labelled(
            "check_value",
            "gauge",
            "Newest value of a check of the system; absent before the first.",
            [(at, one.finding.value) for at, one in zip(units, checks, strict=True)],
        ),
        _make_labelled(
            "check_sigma",
            "gauge",
            "One standard deviation of it.",
            [(at, one.finding.sigma) for at, one in each],
        ),
        _make_labelled(
            "check_limit",
            "gauge",
            "Value beyond which, with its sigma, it is a fault.",
            [(at, one.finding.limit) for at, one in each],
        ),
        _make_labelled(
            "check_fault",
            "gauge",
            "1 while the check finds a fault.",
            [(at, float(one.finding.is_fault)) for at, one in each],
        ),
        _make_labelled(
            "check_age_seconds", "gauge", "Since the check was made.", [(at, one.age_s) for at, one in each]
        ),
    ]


def make_router(context: AppContext) -> APIRouter:
    """Return the route GET /metrics."""
    router = APIRouter(tags=["metrics"])
    viewer = require_role("viewer")

    def get_reader(request: Request) -> User | None:
        """Return the viewer; with ``metrics_open`` also accept programs on this machine."""
        is_local = request.client is not None and request.client.host in ("127.0.0.1", "::1")
        return None if context.settings.metrics_open and is_local else viewer(request)

    allowed = Depends(get_reader)

    @router.get(
        "/metrics",
        response_class=Response,
        responses=describe_refusals()
        | {200: {"content": {MEDIA_TYPE: {}}, "description": "Prometheus text format"}},
    )
    def metrics(_: User | None = allowed) -> Response:
        """Figures for Prometheus."""
        return Response(
            format_metrics(context.live_state, context.live_state.take_snapshot()), media_type=MEDIA_TYPE
        )

    return router
