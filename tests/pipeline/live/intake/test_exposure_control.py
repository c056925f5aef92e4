"""The control of the exposure times in a running system: what it changes, logs, and leaves alone."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from beltscape.core.events import FrameEvent, Maintenance
from beltscape.core.frames import FrameSet
from beltscape.pipeline.live.intake import ExposureControl
from beltscape.sources.genicam.settings import CamerasSettings

SETTINGS = CamerasSettings.model_validate(
    {
        "devices": {"cam0": "a", "cam1": "b"},
        "exposure_us": 1000,
        "adaptive_exposure": {"shortest_us": 100, "longest_us": 4000, "every_s": 0.5, "hold_s": 1},
    }
)


class Plant:
    """Cameras under a light, with a control."""

    def __init__(self) -> None:
        self.exposures_us = {"cam0": 1000.0, "cam1": 1000.0}
        self.events: list[tuple[str, Mapping[str, object]]] = []
        self.control = ExposureControl(  # pyrefly: ignore[bad-instantiation]
            SETTINGS, self, "cam0", 1.0, lambda text, parts: self.events.append((text, parts))
        )
        self._number = 0

    def set_exposures(self, exposures_us: Mapping[str, float]) -> None:
        self.exposures_us = dict(exposures_us)

    def run(
        self, light: float, frames: int = 100, speed_mm_s: float = 200.0, stated: float | None = None
    ) -> None:
        """Take frames at 10 frames/s under a light in levels per µs."""
        for _ in range(frames):
            self._number += 1
            images = {
                name: np.full((16, 16), min(255, round(light * us)), np.uint8)
                for name, us in self.exposures_us.items()
            }
            exposures = {name: stated or us for name, us in self.exposures_us.items()}
            one = FrameSet(f"{self._number}", images, self._number * 100_000_000, None, exposures)
            self.control.on_frame(FrameEvent(one, self._number, 0, 0, 0.1, 1.0, speed_mm_s))


def test_light_is_followed_and_every_change_is_logged() -> None:
    plant = Plant()
    plant.run(0.06)

    assert 150 / 1.3 <= 0.06 * plant.exposures_us["cam0"] <= 150 * 1.3
    assert plant.exposures_us["cam0"] == plant.exposures_us["cam1"] == plant.control.exposures_us["cam0"]
    assert len(plant.events) >= 2
    assert "1000 → 1500 µs, all cameras × 1.50: level 60 of 255, wanted 150" in plant.events[0][0]
    assert plant.events[0][1] == {"exposure_us": 1500.0, "factor": 1.5, "level": 60}


def test_speed_shortens_the_exposure() -> None:
    plant = Plant()
    plant.run(0.15, 1, speed_mm_s=2000.0)

    assert plant.exposures_us["cam0"] == 250  # half a pixel of 1 mm at 2 m/s
    assert "the belt moves at 2000 mm/s" in plant.events[0][0]
    plant.run(0.15, 50, speed_mm_s=float("nan"))
    assert plant.exposures_us["cam0"] == 250


def test_maintenance_and_images_of_other_exposure_times_change_nothing() -> None:
    plant = Plant()
    plant.control.on_maintenance(Maintenance("cleaning", "ann", 0, 1))
    plant.run(0.06)
    plant.control.on_maintenance(None)
    plant.run(0.06, stated=900.0)

    assert plant.events == []
