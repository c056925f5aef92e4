"""Belts for the tests of a site: a machine without a network, and records of a given flow."""

from __future__ import annotations

import random
from typing import Any

from beltscape import __version__
from beltscape.site.client import BeltFault, BeltFaultError, PageAnswer, RecordAnswer, StateAnswer
from beltscape.site.settings import SiteSettings

START_MS = 1_790_000_040_000
"""A time at a whole minute."""


def make_site(*names: str, **more: Any) -> SiteSettings:
    """Return the settings of a site with those belts."""
    belts = [{"name": name, "url": f"http://{name}.example", "key_file": "key"} for name in names]
    return SiteSettings.model_validate({"belts": belts, **more})


def make_record(number: int, wall_ms: int, volume_m3: float = 0.05, **more: Any) -> RecordAnswer:
    """Return a record of 0.5 m of belt with a density of 1.6 t/m³ and σ of 1 %."""
    values: dict[str, Any] = {
        "number": number, "run": 1, "wall_ms": wall_ms, "from_m": number * 0.5, "to_m": number * 0.5 + 0.5,
        "standing": "valid", "volume_m3": volume_m3, "sigma_m3": 0.01 * volume_m3, "mass_t": 1.6 * volume_m3,
    }  # fmt: skip
    return RecordAnswer.model_validate({**values, **more})


def make_state(wall_ms: int, record: int, speed_m_s: float = 2.0, age_s: float = 0.1) -> StateAnswer:
    """Return a state with little in it."""
    flow = dict.fromkeys(
        ("volume_m3_h", "sigma_m3_h", "mass_t_h", "mass_sigma_t_h", "area_m2", "coverage"), 1.0
    )
    totals = dict.fromkeys(("volume_m3", "sigma_m3", "mass_t", "valid_m", "degraded_m", "missing_m"), 1.0)
    return StateAnswer.model_validate({
        "wall_ms": wall_ms, "frames": {"speed_m_s": speed_m_s, "age_s": age_s},
        "flow": {**flow, "trend": "steady", "standing": "valid", "age_s": age_s},
        "totals": {**totals, "records": record, "since_ms": START_MS}, "cameras": [], "alarms": [],
        "record": record, "maintenance": None,
    })  # fmt: skip


class FakeBelt:
    """A machine whose ledger the test writes; ``broken`` is the share of requests that fail."""

    def __init__(self, seed: int = 1) -> None:
        self.records: list[RecordAnswer] = []
        self.broken, self.requests = 0.0, 0
        self.clock_ms = START_MS + 1000
        self.limit = 1000
        self._rng = random.Random(seed)

    def read_page(self) -> PageAnswer:
        self._ask()
        return PageAnswer(version=__version__, plant="", stale_s=3.0)

    def read_state(self) -> StateAnswer:
        self._ask()
        return make_state(self.clock_ms, self.records[-1].number if self.records else 0)

    def read_records(self, after: int, since_ms: int) -> list[RecordAnswer]:
        self._ask()
        found = [one for one in self.records if one.number > after and one.wall_ms >= since_ms]
        return found[: self.limit]

    def close(self) -> None:
        """Nothing is open."""

    def _ask(self) -> None:
        self.requests += 1
        if self._rng.random() < self.broken:
            raise BeltFaultError(BeltFault("timeout", {"url": "http://belt"}))
