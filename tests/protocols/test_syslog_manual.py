"""The manual's page of alarms: its message is what is sent, and its listeners receive it."""

from __future__ import annotations

import re
import shutil
import subprocess
import time
import tomllib
from collections.abc import Sequence
from pathlib import Path

import pytest

from beltscape.core.alarm_catalogue import MATRIX
from beltscape.core.alarms import Alarm
from beltscape.protocols.settings import SyslogSettings
from beltscape.protocols.syslog import Origin, SyslogSender, describe_change, format_message
from tests.protocols.broker import find_port
from tests.protocols.syslog_server import parse

PAGE = (Path(__file__).parents[2] / "docs" / "howto" / "alarms.md").read_text(encoding="utf-8")
OVERLOAD = Alarm(
    "overload", "critical", "raised", 112.5, 100.0, "%", 1, "112 %, limit 100 %: slow the feed", priority="urgent",
    group="load", is_first=True,
)  # fmt: skip
RSYSLOG = shutil.which("rsyslogd") or ("/usr/sbin/rsyslogd" if Path("/usr/sbin/rsyslogd").exists() else None)


def find_block(after: str) -> str:
    """Return the first block behind a text of the page."""
    found = re.search(r"```\w+\n(.*?)```", PAGE[PAGE.index(after) :], re.DOTALL)
    assert found is not None
    return found[1]


def read_settings(port: int, **more: object) -> SyslogSettings:
    """Return the settings of the page, at a free port."""
    table = tomllib.loads(find_block("Add a table"))["syslog"]
    return SyslogSettings.model_validate({**table, "port": port, **more})


def send(settings: SyslogSettings) -> None:
    sender = SyslogSender(settings)
    sender.start()
    sender.on_alarms([OVERLOAD])
    sender.close()


def run_until_written(command: Sequence[str], settings: SyslogSettings, output: Path) -> str:
    """Run a listener, send an alarm until it arrives, and return what the listener wrote."""
    with (output.with_suffix(".log")).open("w") as log, output.open("a") as out:
        process = subprocess.Popen(command, stdout=out, stderr=log)
        try:
            end_s = time.monotonic() + 10
            while "overload" not in output.read_text() and time.monotonic() < end_s:
                send(settings)
                time.sleep(0.1)
        finally:
            process.terminate()
            process.wait(5)
    return output.read_text(encoding="utf-8")


def test_the_message_of_the_page_is_what_is_sent() -> None:
    shown = find_block("<!-- message -->").strip()
    origin = Origin(16, "measuring-pc", "belt4", "4711", 32473)
    sent = format_message(describe_change(OVERLOAD, 1_795_444_370_573_313_000), origin, 0).decode()
    assert re.sub(r"Z|2026-[-\d:T.]+", "", shown) == re.sub(r"Z|2026-[-\d:T.]+", "", sent)
    assert parse(shown.encode()).alarm["name"] == "overload"


@pytest.mark.skipif(shutil.which("nc") is None, reason="needs nc (Debian's netcat-openbsd)")
def test_netcat_receives_it(tmp_path: Path) -> None:
    port = find_port()
    command = [str(port) if word == "5514" else word for word in find_block("Listen on").split()]
    got = run_until_written(command, read_settings(port), tmp_path / "nc.out")
    assert "belt4" in got and "overload raised: 112 %" in got


@pytest.mark.skipif(RSYSLOG is None, reason="needs rsyslogd (Debian's rsyslog)")
def test_rsyslog_takes_it_apart(tmp_path: Path) -> None:
    port, output = find_port(), tmp_path / "belt4.log"
    output.touch()
    text = (
        find_block("<!-- rsyslog -->").replace("5514", str(port)).replace("/var/log/belt4.log", str(output))
    )
    (tmp_path / "rsyslog.conf").write_text(text)
    command = [str(RSYSLOG), "-n", "-f", str(tmp_path / "rsyslog.conf"), "-i", str(tmp_path / "pid")]
    got = run_until_written(command, read_settings(port, transport="tcp"), output)
    message = parse(got.splitlines()[0].encode())
    assert (message.app, message.severity, message.alarm["state"]) == ("belt4", 1, "raised")


def test_the_matrix_of_the_page_is_the_program_s() -> None:
    for consequence, row in MATRIX.items():
        assert re.search(rf"\({consequence}\) \| {' '.join(f'{one} [|]' for one in row.values())}", PAGE)
