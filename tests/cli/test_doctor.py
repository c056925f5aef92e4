"""``beltscape doctor``: every line is ok or a warning with its fix."""

from __future__ import annotations

import json
import re

import pytest

from beltscape.cli.main import main
from beltscape.pipeline.installation import (
    check_clock,
    check_disk,
    check_kernels,
    check_network_cards,
    check_socket_buffers,
)


def test_every_line_is_ok_or_says_the_fix(capsys, tmp_path):
    assert main(["doctor", "--data", str(tmp_path), "--json"]) == 0
    checks = json.loads(capsys.readouterr().out)["checks"]
    assert {"beltscape", "kernels", "threads", "socket buffers", "disk", "clock", "browser", "GPU"} <= {
        one["name"] for one in checks
    }
    matching = next(one["found"] for one in checks if one["name"] == "matching")
    answer = re.fullmatch(
        r"(\S+) s of a core for a frame set of 5 cameras, 612×512 px, fast: (\d+) cores match (\S+) a second",
        matching,
    )
    assert answer
    seconds, cores, rate = answer.groups()
    assert float(rate) == pytest.approx(int(cores) / float(seconds), rel=0.1)
    assert all((one["state"] == "warning") == bool(one["fix"]) for one in checks)
    assert main(["doctor", "--data", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    states = [line.split()[0] for line in lines if line.strip() and not line.startswith(" ")]
    # a busy machine may answer some checks otherwise the second time
    assert len(states) == len(checks)
    assert len(lines) == len(checks) + states.count("warning")


def test_small_packets_and_cards_that_are_down(tmp_path):
    for name, state, mtu in (
        ("lo", "up", 65536),
        ("eth0", "up", 1500),
        ("eth1", "up", 9000),
        ("eth2", "down", 1500),
    ):
        (tmp_path / name).mkdir()
        (tmp_path / name / "operstate").write_text(state + "\n")
        (tmp_path / name / "mtu").write_text(f"{mtu}\n")
    checks = list(check_network_cards(tmp_path))
    assert [(one.name, one.state) for one in checks] == [("network eth0", "warning"), ("network eth1", "ok")]
    assert "ip link set eth0 mtu 9000" in checks[0].fix


@pytest.mark.parametrize(("answer", "state"), [("yes", "ok"), ("no", "warning"), (None, "warning")])
def test_a_clock_of_which_nothing_is_known_is_not_ok(monkeypatch, answer, state):
    monkeypatch.setattr("beltscape.pipeline.installation._run_program", lambda *_: answer)
    assert check_clock().state == state


@pytest.mark.parametrize(
    ("size", "state"), [("212992", "warning"), ("33554432", "ok"), ("no number", "warning")]
)
def test_socket_buffers(size, state, tmp_path):
    limit = tmp_path / "rmem_max"
    limit.write_text(size)
    assert check_socket_buffers(limit).state == state


def test_a_folder_that_is_not_there_yet_is_tried_on_its_disk(tmp_path):
    check = check_disk(tmp_path / "later" / "data")
    assert str(tmp_path) in check.found
    assert "MB/s" in check.found


def test_slower_kernels_than_the_processor_runs_are_named(monkeypatch):
    from beltscape.kernels import load

    monkeypatch.setenv("BELTSCAPE_KERNELS", "reference")
    load.cache_clear()
    try:
        assert "unset BELTSCAPE_KERNELS" in check_kernels().fix
    finally:
        monkeypatch.undo()
        load.cache_clear()
    assert check_kernels().state == "ok"
