"""Load of the protocols: CPU seconds per second of a service with none, each and all of them; delay of a frame.

    cd benchmarks; python -m protocols.load [--seconds 12] [--rounds 2]

A simulated plant sends ten frame sets and records a second, without images and matching, to live state and history;
clients in another process read the protocols as a control room does.
"""

from __future__ import annotations

import argparse
import json
import logging
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Generator, Iterable
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.core.events import FrameEvent
from beltscape.core.frames import FrameSet
from beltscape.core.ledger import BeltRecord, CrossSection, FlowRecord
from beltscape.pipeline.live.writer import Writer, notify_records
from beltscape.protocols.settings import (
    AnalogueSettings,
    ModbusSettings,
    MqttSettings,
    OpcUaSettings,
    OutputSettings,
    PulseSettings,
    SyslogSettings,
)
from beltscape.service.live_state import LiveState
from beltscape.service.protocols import ProtocolSettings, ServedPlant, ServedProtocols
from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from protocols.clients import READ, describe_reading, read_all

NOTES = """A simulated plant at 10 frame sets and records a second with cross-sections of 301 points, without
matching: its CPU seconds per second, as the mean of the rounds, with one client for each protocol. Modbus: all
registers ten times a second. MQTT: every record, and the state each second, to mosquitto and a subscriber, as JSON or
as Sparkplug B. OPC UA: a subscription to every variable, without encryption. syslog: changes of alarms by UDP.
Outputs: three pulses a second, two currents and a heartbeat five times a second, to an I/O module. *All* is every
table that project.toml can have at once: MQTT has one form. *Frame*: time that the feeding thread spends for a frame
set, which a protocol could delay; the machine has other work beside it."""
_OTHERS = ("modbus", "opcua", "syslog", "outputs")
CASES: dict[str, tuple[str, ...]] = {
    "none": (),
    **{name: (name,) for name in ("modbus", "mqtt", "sparkplug", "opcua", "syslog", "outputs")},
    "all, MQTT as JSON": ("mqtt", *_OTHERS),
    "all, MQTT as Sparkplug": ("sparkplug", *_OTHERS),
}
"""By row of the table: what is served."""
BENCHMARKS = Path(__file__).parents[1]
_HZ, _WARM_S, _STEP_MM = 10.0, 4.0, 120.0
_X_MM = np.linspace(-600, 600, 301, dtype=np.float32)


@dataclass(frozen=True)
class Load:
    """The load of one configuration."""

    cpu: float
    """CPU seconds per second."""
    frame_ms: tuple[float, float, float]
    """Median, 99 % and maximum of the time that a frame set takes."""


def main() -> None:
    """Measure, and print or write the table."""
    parser = argparse.ArgumentParser(description="load of the protocols")
    parser.add_argument("--seconds", type=float, default=12.0)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--serve", help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve is not None:
        print(json.dumps(serve(json.loads(options.serve), options.folder, options.seconds)))
        return
    print("\n".join(protocols_load(options.seconds, options.rounds)))


def protocols_load(seconds: float = 12.0, rounds: int = 2) -> list[str]:
    """Return the Markdown table; the reason if a library or the broker is missing."""
    missing = [name for name in ("asyncua", "paho", "pymodbus") if find_spec(name) is None]
    if missing or find_broker() is None:
        return [f"Not run: {', '.join(missing) or 'mosquitto'} is not installed."]
    for name in ("asyncua", "pymodbus_internal"):  # the clients begin before the servers and outlive them
        logging.getLogger(name).setLevel(logging.CRITICAL)
    loads: dict[str, list[Load]] = {name: [] for name in CASES}
    for _ in range(rounds):  # in turn, so that other work of the machine falls on all
        for name, served in CASES.items():
            loads[name].append(measure(served, seconds))
    none = mean(loads["none"])
    lines = [
        NOTES,
        "",
        "| protocols | CPU s/s | more than none | frame ms: median | 99 % | most |",
        "|---|---|---|---|---|---|",
    ]
    for name, found in loads.items():
        times = " | ".join(f"{max(one.frame_ms[i] for one in found):.2f}" for i in range(3))
        lines.append(
            f"| {name} | {mean(found):.4f} | {100 * (mean(found) - none):+.2f} % of a core | {times} |"
        )
    return lines


def mean(loads: list[Load]) -> float:
    """Return the mean CPU seconds per second."""
    return sum(one.cpu for one in loads) / len(loads)


def measure(names: tuple[str, ...], seconds: float) -> Load:
    """Serve these protocols in a process of its own, with clients in this one."""
    with (
        tempfile.TemporaryDirectory() as folder,
        run_broker(Path(folder), needed=not BROKERED.isdisjoint(names)) as broker,
    ):
        ports = find_ports(names) | dict.fromkeys(BROKERED.intersection(names), broker)
        words = ["--serve", json.dumps(ports), "--folder", folder, "--seconds", str(seconds)]
        before = dict(READ)
        command = [sys.executable, "-m", "protocols.load", *words]
        with read_all(ports):
            process = subprocess.Popen(command, cwd=BENCHMARKS, stdout=subprocess.PIPE, text=True)
            out, _ = process.communicate()
    idle = [name for name in READ if name in names and READ[name] - before[name] < seconds]
    if idle:
        raise RuntimeError(f"clients read nothing: {describe_reading(idle)}")
    found = json.loads(out.splitlines()[-1])
    return Load(found["cpu"], tuple(found["frame_ms"]))


def serve(ports: dict[str, int], folder: Path, seconds: float) -> dict[str, Any]:
    """Serve a simulated plant for a time; return its load."""
    settings = ProtocolSettings(
        **{"mqtt" if name in BROKERED else name: SETTINGS[name](port) for name, port in ports.items()}
    )
    historian = Historian(folder / "data", HistorySettings(reserve_mib=1))
    live_state = LiveState()
    writer = Writer("historian", historian, notify_records(live_state, historian))
    plant = ServedPlant(live_state, historian, lambda _alarm, _by: True)
    protocols = ServedProtocols(plant, folder / "data", lambda _: None)
    protocols.serve(settings)
    feed(live_state, writer, 1, _WARM_S)
    began_cpu, began = time.process_time(), time.monotonic()
    taken = feed(live_state, writer, 1 + round(_WARM_S * _HZ), seconds)
    cpu = (time.process_time() - began_cpu) / (time.monotonic() - began)
    protocols.close()
    writer.close()
    historian.close()
    quantiles = np.percentile(taken, (50, 99, 100)).tolist()
    return {"cpu": cpu, "frame_ms": [1e3 * one for one in quantiles]}


def feed(live_state: LiveState, writer: Writer, first: int, seconds: float) -> list[float]:
    """Send frame sets and records for a time; return the seconds that each took."""
    taken: list[float] = []
    began = time.monotonic()
    for k in range(round(seconds * _HZ)):
        time.sleep(max(0.0, began + k / _HZ - time.monotonic()))
        start = time.perf_counter()
        number = first + k
        frames = FrameSet(f"{number:06d}", {}, number * 100_000_000, number * _STEP_MM)
        live_state.on_frame(FrameEvent(frames, number, 0, 0, 0.05, 0.96, _STEP_MM * _HZ))
        writer.put([make_record(number)])
        taken.append(time.perf_counter() - start)
    return taken


def make_record(number: int) -> BeltRecord:
    """Return the record of a belt with a ridge."""
    height = (80 * np.exp(-((_X_MM / 300) ** 2)) + number % 7).astype(np.float32)
    interval = ((number - 1) * _STEP_MM, number * _STEP_MM)
    area = float(height.sum() * 4)
    strip = FlowRecord(
        f"{number:06d}", number * 100_000_000, interval[0], interval, area, area * _STEP_MM,
        area * _STEP_MM * 0.01, _STEP_MM * _HZ, 1600.0, 0.96, 0.9, "measured",
    )  # fmt: skip
    wall_ns = time.time_ns()
    return BeltRecord(number, 1, interval, "valid", "", wall_ns, strip, 1.0, 5, CrossSection(_X_MM, height))


SETTINGS: dict[str, Callable[[int], Any]] = {
    "modbus": lambda port: ModbusSettings(port=port, pulse_kg=100),
    "mqtt": lambda port: MqttSettings(host="127.0.0.1", port=port),
    "sparkplug": lambda port: MqttSettings(host="127.0.0.1", port=port, payload="sparkplug"),
    "opcua": lambda port: OpcUaSettings(port=port, security="none", clients="any", anonymous_role="viewer"),
    "syslog": lambda port: SyslogSettings(host="127.0.0.1", port=port),
    "outputs": lambda port: OutputSettings(
        host="127.0.0.1",
        port=port,
        heartbeat=12,
        pulse=PulseSettings(kg=25, address=3),
        analogue=(
            AnalogueSettings(value="flow_t_h", address=10, full=1000),
            AnalogueSettings(value="speed_m_s", address=11, full=4),
        ),
    ),
}
"""By protocol: its settings for a port."""
BROKERED = frozenset({"mqtt", "sparkplug"})
"""What speaks to the broker."""


def find_broker() -> str | None:
    """Return the program of mosquitto where it is installed."""
    return shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")


@contextmanager
def run_broker(folder: Path, *, needed: bool) -> Generator[int]:
    """Run mosquitto and yield its port; 0 if none is needed."""
    if not needed:
        yield 0
        return
    program, port = find_broker(), find_ports(["mqtt"])["mqtt"]
    assert program is not None
    (folder / "mosquitto.conf").write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\nuser root\n")
    process = subprocess.Popen([program, "-c", str(folder / "mosquitto.conf")], stderr=subprocess.DEVNULL)
    time.sleep(0.5)
    try:
        yield port
    finally:
        process.terminate()
        process.wait()


def find_ports(names: Iterable[str]) -> dict[str, int]:
    """Return by name a free TCP port, each another one."""
    with ExitStack() as held:
        sockets = {name: held.enter_context(socket.socket()) for name in names}
        for one in sockets.values():
            one.bind(("127.0.0.1", 0))
        return {name: one.getsockname()[1] for name, one in sockets.items()}


if __name__ == "__main__":
    main()
