"""Outputs to an I/O module: pulses exactly once over kills and lost answers, currents with those of a failure."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from beltscape.core.errors import OutputError
from beltscape.core.ledger import Totals

pytest.importorskip("pymodbus", reason="pymodbus is not installed; pip install 'beltscape[modbus]' brings it")

from beltscape.protocols import kept_number, outputs
from beltscape.protocols.output_pulses import CoilOutput, CounterOutput, PulseOutput, PulseTarget, read_steps
from beltscape.protocols.outputs import ModuleAwayError, OutputWriter, compute_current_ma
from beltscape.protocols.settings import AnalogueSettings, OutputSettings, PulseSettings
from tests.protocols.broker import wait_until
from tests.protocols.io_module import COIL, COUNTER, IoModule
from tests.protocols.plant import FakePlant

KEY = "step", "25.0 kg"


@pytest.fixture
def io() -> Iterator[IoModule]:
    one = IoModule()
    one.start()
    yield one
    one.stop()


def make_settings(io: IoModule, kind: str = "coil", **more: Any) -> OutputSettings:
    address = COIL if kind == "coil" else COUNTER
    pulse = {"kg": 25.0, "kind": kind, "address": address, "on_ms": 5, "off_ms": 5}
    values = {"host": "127.0.0.1", "port": io.port, "every_s": 0.05, "pulse": pulse, **more}
    return OutputSettings.model_validate(values)


def weigh(plant: FakePlant, mass_kg: float, records: int = 0) -> None:
    """Let a mass have passed since the ledger began."""
    totals = Totals(records, mass_kg * 1e6, 0.0, mass_kg, 1.0, 0.0, 0.0)
    plant.state = replace(plant.state, totals=totals)


class Killed(BaseException):
    """The program is killed at this place."""


class UncertainModule:
    """A module whose requests and answers are lost at random; it counts rising edges."""

    def __init__(self, rng: random.Random) -> None:
        self.coil, self.edges, self.counts = False, 0, list[int]()
        self._rng = rng

    def write_coil(self, address: int, *, is_on: bool) -> None:
        self._lose()
        self.edges += is_on and not self.coil
        self.coil = is_on
        self._lose()

    def read_coil(self, address: int) -> bool:
        self._lose()
        return self.coil

    def write_registers(self, address: int, words: list[int]) -> None:
        self._lose()
        self.counts.append((words[0] << 16) + words[1])
        self._lose()

    def _lose(self) -> None:
        draw = self._rng.random()
        if draw < 0.1:
            raise ModuleAwayError("lost")
        if draw < 0.2:
            raise Killed


@pytest.mark.parametrize("kind", ["coil", "counter"])
def test_no_pulse_is_lost_or_doubled_wherever_the_program_is_killed(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = random.Random(5)
    module = UncertainModule(rng)
    write = kept_number.keep_state

    def write_or_die(path: Path, data: bytes) -> None:
        if rng.random() < 0.1:
            raise Killed
        if rng.random() < 0.1:
            raise OutputError("the disk is full")
        write(path, data)
        if rng.random() < 0.1:
            raise Killed

    monkeypatch.setattr(kept_number, "keep_state", write_or_die)
    settings = PulseSettings(kg=25.0, kind=kind, address=3, on_ms=5, off_ms=5)  # pyrefly: ignore[bad-argument-type]
    ticks = iter(range(1 << 30))

    def start() -> PulseOutput:
        kept = read_steps(tmp_path, KEY, print)
        coil = CoilOutput(settings, kept, clock=lambda: float(next(ticks)))
        return coil if settings.kind == "coil" else CounterOutput(settings, kept)

    output, kills, due = start(), 0, 0
    for turn in range(2000):
        due = turn // 10
        try:
            output.advance(module, due)
        except (ModuleAwayError, OutputError):
            output.forget()
        except Killed:
            kills += 1
            output = start()
        assert module.edges <= due
    assert kills > 200
    given = module.edges if kind == "coil" else module.counts[-1]
    assert due - 3 <= given <= due
    assert module.counts == sorted(module.counts)


def test_pulses_at_a_module_that_restarts(
    io: IoModule, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outputs, "_TIMEOUT_S", 0.15)
    monkeypatch.setattr(outputs, "_PAUSE_S", 0.02)
    plant, rng, messages = FakePlant(), random.Random(3), list[str]()
    weigh(plant, 1000.0)  # what has passed before the outputs began gives no pulse
    writer = OutputWriter(make_settings(io), plant, tmp_path, messages.append)
    writer.start()
    wait_until((tmp_path / "outputs_pulses.json").is_file)
    io.lost_answers = 0.05
    mass = 1000.0
    for _ in range(3):
        mass += 25.0 * rng.randint(3, 12)
        weigh(plant, mass)
        time.sleep(rng.uniform(0.0, 0.3))
        io.stop()
        time.sleep(rng.uniform(0.0, 0.2))
        io.start()
    expected = round((mass - 1000.0) / 25.0)
    wait_until(lambda: io.edges == expected and not io.coil)
    time.sleep(0.2)
    assert io.edges == expected
    assert any("outputs: 127.0.0.1" in text for text in messages)
    writer.close()
    assert not io.coil


PROGRAM = """
import sys, time
sys.path.insert(0, {root!r})
from dataclasses import replace
from beltscape.protocols.settings import OutputSettings
from beltscape.protocols.outputs import OutputWriter
from tests.protocols.plant import FakePlant
from tests.protocols.test_outputs import weigh
plant = FakePlant()
mass = float(sys.argv[2])
weigh(plant, mass)
writer = OutputWriter(OutputSettings.model_validate_json(sys.argv[1]), plant, __import__("pathlib").Path({data!r}))
writer.start()
print("runs", flush=True)
while True:
    time.sleep(0.02)
    mass += 25.0
    weigh(plant, mass)
    print(mass, flush=True)
"""


@pytest.mark.thorough
@pytest.mark.slow
def test_pulses_of_a_program_that_is_killed_at_random(io: IoModule, tmp_path: Path) -> None:
    # it starts three interpreters: a kill is only real in a process
    rng, mass = random.Random(8), 0.0
    code = PROGRAM.format(root=str(Path(__file__).resolve().parents[2]), data=str(tmp_path))
    settings = make_settings(io).model_dump_json()
    for _ in range(3):
        process = subprocess.Popen(
            [sys.executable, "-c", code, settings, str(mass)], stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(rng.uniform(0.1, 0.5))
        process.send_signal(signal.SIGKILL)
        lines = process.stdout.read().split()
        process.wait()
        process.stdout.close()
        mass = float(lines[-1]) if lines else mass
    plant = FakePlant()
    weigh(plant, mass)
    writer = OutputWriter(make_settings(io), plant, tmp_path)
    writer.start()
    wait_until(lambda: io.edges == round(mass / 25.0))
    time.sleep(0.1)
    writer.close()
    assert io.edges == round(mass / 25.0)
    assert io.edges > 10


def test_a_counter_is_written_again_after_the_module_has_lost_it(io: IoModule, tmp_path: Path) -> None:
    plant = FakePlant()
    writer = OutputWriter(make_settings(io, "counter"), plant, tmp_path)
    writer.start()
    wait_until(lambda: bool(io.counts))
    weigh(plant, 25.0 * 70_000)
    wait_until(lambda: io.counts[-1] == 70_000)
    io.registers.clear()
    wait_until(lambda: io.registers.get(COUNTER) == 1 and io.registers.get(COUNTER + 1) == 70_000 - 65_536)
    assert io.counts == sorted(io.counts)
    writer.close()


def test_currents_follow_the_value_and_show_a_failure(io: IoModule, tmp_path: Path) -> None:
    plant = FakePlant()
    analogue = [
        {"value": "flow_m3_h", "address": 1, "full": 246.8},
        {"value": "flow_t_h", "address": 2, "zero": -100, "full": 100, "failure": "high"},
        {"value": "speed_m_s", "address": 4, "full": 5, "register_4_ma": 6554, "register_20_ma": 32_767},
    ]
    writer = OutputWriter(make_settings(io, analogue=analogue, heartbeat=9), plant, tmp_path)
    writer.start()
    wait_until(lambda: 9 in io.registers)  # the last that is written
    # 104.9 of 100 is beyond the scale; the speed is not known: 3.5 mA
    assert [io.registers[address] for address in (1, 2, 4)] == [12_000, 20_392, 5735]
    beat = io.registers[9]
    wait_until(lambda: io.registers[9] > beat)
    plant.state = replace(plant.state, standing="missing")
    wait_until(lambda: (io.registers[1], io.registers[2]) == (3500, 21_500))
    plant.state = replace(plant.state, standing="valid")
    wait_until(lambda: io.registers[1] == 12_000)
    writer.close()  # without the program nothing is known
    assert (io.registers[1], io.registers[2]) == (3500, 21_500)


@pytest.mark.parametrize(
    ("value", "current_ma"), [(-50.0, 3.8), (0.0, 4.0), (50.0, 12.0), (100.0, 20.0), (500.0, 20.5)]
)
def test_the_range_of_ne_43(value: float, current_ma: float) -> None:
    state = replace(FakePlant().state, mass_flow_t_h=value)
    settings = AnalogueSettings(value="flow_t_h", address=0, full=100.0)
    assert compute_current_ma(settings, state) == pytest.approx(current_ma)
    unknown = replace(state, mass_flow_t_h=float("nan"))
    assert compute_current_ma(settings, unknown) == 3.5


def test_a_replaced_ledger_and_a_falling_total_give_no_wrong_pulse(tmp_path: Path) -> None:
    settings = PulseSettings(kg=25.0, address=0)
    plant, given = FakePlant(), 0
    target = PulseTarget(settings, tmp_path)
    for mass, record, expected in (
        (1000.0, 900, 0),
        (1250.0, 1000, 10),
        (1240.0, 1010, 10),
        (1300.0, 1500, 12),
    ):
        weigh(plant, mass)
        given, is_replaced = target.update(replace(plant.state, record=record), given)
        assert (given, is_replaced) == (expected, False)
    target = PulseTarget(settings, tmp_path)  # a restart
    weigh(plant, 50.0)
    assert target.update(replace(plant.state, record=30), given) == (12, True)
    weigh(plant, 100.0)
    assert target.update(replace(plant.state, record=60), 12) == (14, False)
    weigh(plant, float("nan"))
    assert target.update(replace(plant.state, record=61), 14) == (14, False)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({}, "no output"),
        ({"pulse": {"address": 1}}, "give either kg or l"),
        ({"pulse": {"address": 1, "kg": 5, "l": 5}}, "give either kg or l"),
        ({"analogue": [{"value": "flow_t_h", "address": 1, "full": 0}]}, "zero = full"),
        ({"analogue": [{"value": "flow_t_h", "address": 1, "full": 9, "register_4_ma": 0}]}, "do not fit"),
        (
            {"heartbeat": 2, "pulse": {"address": 1, "kg": 5, "kind": "counter"}},
            "two outputs have the register 2",
        ),
    ],
)
def test_settings_that_do_not_fit_are_named(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        OutputSettings.model_validate({"host": "module", **values})
