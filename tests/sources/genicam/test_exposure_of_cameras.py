"""Exposure times that are changed while the cameras run: the threads, and Aravis's simulated cameras."""

from __future__ import annotations

import numpy as np

from beltscape.sources.fake_genicam.camera import scale_exposure
from beltscape.sources.fake_genicam.simulated_cameras import SimulatedCameras
from beltscape.sources.genicam.settings import CamerasSettings
from beltscape.sources.genicam.source import open_cameras
from tests.sources.genicam.test_camera_threads import Steered, fetch, source_of

ADAPTIVE = {"shortest_us": 100, "longest_us": 5000}


def test_every_image_has_its_exposure_time_also_after_a_return() -> None:
    first, again = Steered(), Steered()
    other = Steered()
    source = source_of(
        {"cam0": [first, again], "cam1": [other]},
        exposure_us=1000,
        adaptive_exposure=ADAPTIVE,
    )
    before = fetch(source, lambda one: len(one.images) == 2)[-1][1]
    source.set_exposures({"cam0": 1500.0, "cam1": 1600.0})
    fetch(source, lambda one: one.exposures_us == {"cam0": 1500.0, "cam1": 1600.0})
    first.is_lost = True
    fetch(source, lambda one: again.frames > 1 and len(one.images) == 2)
    source.close()

    assert before.exposures_us == {"cam0": 1000.0, "cam1": 1000.0}
    assert first.exposures_us == [1500.0]
    assert again.exposures_us == [1500.0]


def test_the_cameras_own_exposure_time_is_not_known() -> None:
    source = source_of({"cam0": [Steered()]})
    frames = fetch(source, lambda one: bool(one.images))[-1][1]
    source.close()

    assert frames.exposures_us == {}


def test_simulated_cameras_honour_the_exposure_time(fake_network, tmp_path) -> None:
    picture = np.full((48, 64), 60, np.uint8)
    bench = SimulatedCameras(tmp_path / "bench", {"cam0": [picture]}, 10, exposure_us=1000.0)
    settings = {
        "devices": bench.devices,
        "exposure_us": 1000,
        "adaptive_exposure": ADAPTIVE,
        "packet_size": 9000,
    }
    with bench:
        source = open_cameras(CamerasSettings.model_validate(settings), "cam0", bench.sizes_px)
        levels: dict[float, int] = {}
        for number, frames in enumerate(source):
            if "cam0" in frames.images:
                levels[frames.exposures_us["cam0"]] = int(frames.images["cam0"][0, 0])
                source.set_exposures({"cam0": 2000.0 if 1000.0 in levels else 1000.0})
            if 2000.0 in levels or number > 60:
                break
        source.close()

    assert levels == {1000.0: 60, 2000.0: 120}


def test_longer_exposure_saturates() -> None:
    assert scale_exposure(np.array([[0, 100, 200]], np.uint8), 1.5).tolist() == [[0, 150, 255]]
    assert scale_exposure(np.array([[40000]], np.uint16), 0.5).tolist() == [[20000]]
