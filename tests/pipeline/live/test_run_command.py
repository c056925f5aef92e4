"""``beltscape run`` and ``replay``: refused settings, and a recording through the whole system."""

from __future__ import annotations

import contextlib
import csv
import io
import os
import shutil
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest

from beltscape.cli.main import main
from tests.pipeline.live.conftest import PROJECT
from tests.protocols.broker import MQTT_3_REFUSAL, answer_every_client, find_port
from tests.synthetic.demo import parse_json
from tests.thorough import THOROUGH

OPC_UA = "[opcua]\nport = 0\n" if THOROUGH else ""
"""Its certificate takes seconds; tests/service/test_protocol_users.py shows that the log has its thumbprint."""


@pytest.fixture(scope="module")
def replayed(standing_belt, tmp_path_factory) -> Path:
    """The plant's folder, whose recording was replayed into its folder ``out``; no test writes into it."""
    folder = tmp_path_factory.mktemp("replayed") / "plant"
    shutil.copytree(standing_belt, folder)
    (folder / "project.toml").write_text(PROJECT)
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        assert main(["replay", str(folder / "project.toml"), "--out", str(folder / "out"), "--json"]) == 0
    (folder / "answer.json").write_text(printed.getvalue())
    return folder


def test_replay_gives_the_records_of_the_command(run, replayed, plant, tmp_path):
    answer = parse_json((replayed / "answer.json").read_text())
    assert answer["records"] == 2
    assert answer["missing_mm"] == 0
    assert answer["totals"]["volume_mm3"] == answer["volume_mm3"]
    flow = tmp_path / "flow"
    code, _, _ = run(
        "measure", "flow", tmp_path / "belt", "--rig", tmp_path / "rig.json", "--empty", tmp_path / "empty",
        "--encoder", tmp_path / "belt" / "encoder.csv", "--preset", "fast", "--load", 150, "--out", flow,
    )  # fmt: skip
    assert code == 0
    rows = list(csv.DictReader((flow / "flow.csv").read_text().splitlines()))
    assert sum(float(row["volume_mm3"]) for row in rows) == pytest.approx(answer["volume_mm3"], abs=0.01)
    assert answer["valid_mm"] + answer["degraded_mm"] == pytest.approx(answer["totals"]["valid_mm"], abs=1e-6)


@pytest.mark.thorough
def test_second_replay_into_the_same_folder_counts_nothing_twice(run, replayed, plant, tmp_path):
    shutil.copytree(replayed / "out", tmp_path / "out")
    code, again, _ = run("replay", plant, "--out", tmp_path / "out", "--json")
    assert code == 0
    lengths = []
    for printed in ((replayed / "answer.json").read_text(), again):
        totals = parse_json(printed)["totals"]
        lengths.append(totals["valid_mm"] + totals["degraded_mm"] + totals["missing_mm"])
    assert lengths[1] == pytest.approx(lengths[0], abs=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('preset"', 'preset"', ""),
        ("load_mm = 150", "lod_mm = 150", "unknown key matching.lod_mm; did you mean load_mm?"),
        ("load_mm = 150", "load_mm = -1", "matching.load_mm = -1"),
        ('rig = "rig.json"', 'rig = "none.json"', "none.json': no such file"),
        ("[capture]", "[cameras]\ndevices = {cam0 = 'x'}\n[capture]", "give either [cameras] or [capture]"),
        ("kg_m3 = 1500", 'kg_m3 = 1500\ntable = "d.csv"', "give the density in one way only"),
        ("[web]", "[recordings]\nx = 1\n[web]", "unknown key recordings; did you mean recording?"),
    ],
)
def test_invalid_settings_are_refused_in_one_line(run, plant, old, new, message):
    if not message:
        assert run("run", plant, "--check")[0] == 0
        return
    plant.write_text(PROJECT.replace(old, new))
    code, out, err = run("run", plant, "--no-page")
    assert code == 2
    assert out == ""
    assert message in err[-1]
    assert str(plant) in err[-1]
    assert not (plant.parent / "data").exists()


def test_run_serves_and_stops_in_order(run, plant, tmp_path):
    log = tmp_path / "log"
    text = PROJECT.replace("[encoder]", "loop = true\n[encoder]")
    times = "".join(f"{number:03d},{3 * number},5000\n" for number in range(2))
    (tmp_path / "belt" / "encoder.csv").write_text(f"frame,timestamp_s,belt_position_mm\n{times}")
    protocols = (
        f'[mqtt]\nhost = "127.0.0.1"\nport = {answer_every_client(MQTT_3_REFUSAL)}\n'
        f'[outputs]\nhost = "127.0.0.1"\nport = {find_port()}\npulse = {{l = 5, address = 0}}\n'
        f"{OPC_UA}"
    )
    plant.write_text(f'{text}[reports]\npdf = true\nprinter = "no-such-printer"\n{protocols}')
    with log.open("wb") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", "beltscape", "run", str(plant)], stderr=file, stdout=subprocess.DEVNULL
        )
    try:
        address = _address(process, log)
        with urllib.request.urlopen(address + "/login", timeout=10) as answer:
            assert answer.status == 200
        code, _, err = run("run", plant)  # another process has the data
        assert code == 2
        assert "data" in err[-1]
        for (
            line
        ) in (  # the run goes on without printer, broker and module; docs/howto say that the log names why
            "alarm reports_failing raised: [reports] printer",
            "refused (the broker does not speak MQTT 5; update it",
            "outputs: 127.0.0.1 port",
            *(["thumbprint "] if OPC_UA else []),
        ):
            _wait_for(log, line)
    finally:
        process.send_signal(signal.SIGTERM)
    assert process.wait(60) == 0
    assert (tmp_path / "data" / "history.db").is_file()


def _wait_for(log: Path, text: str) -> None:
    deadline = time.monotonic() + 60
    while text not in log.read_text():
        assert time.monotonic() < deadline, log.read_text()
        time.sleep(0.1)


def _address(process: subprocess.Popen[bytes], log: Path) -> str:
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and process.poll() is None:
        lines = [line for line in log.read_text().splitlines() if "the page is at " in line]
        if lines:
            return lines[0].rpartition(" ")[2]
        time.sleep(0.1)
    os.kill(process.pid, signal.SIGKILL)
    raise AssertionError(log.read_text())
