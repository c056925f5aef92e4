"""``beltscape reprocess``: the same ledger as one run, with any number of workers, kills, damage and changes."""

from __future__ import annotations

import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
import time
import zipfile
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from beltscape.reprocessing import run as module
from tests.reprocessing.conftest import FRAMES, STEP_MM
from tests.reprocessing.ledgers import read_records
from tests.synthetic.demo import parse_json
from tests.workers.processes import find_workers


def read_result(store: Path) -> dict[str, Any]:
    """Return the result of the run that filled a store."""
    return json.loads((store / "reprocessing.json").read_text())


def test_one_recording_gives_the_records_of_a_replay(run, recorded_plant, moving_store, tmp_path) -> None:
    code, out, _ = run("replay", recorded_plant / "project.toml", "--out", tmp_path / "replayed", "--json")
    assert code == 0
    answer = read_result(moving_store)
    assert (answer["recordings"], answer["pieces"], answer["frames"]) == (1, 1, FRAMES)
    assert read_records(moving_store / "history") == read_records(tmp_path / "replayed")
    assert answer["totals"]["volume_mm3"] == parse_json(out)["totals"]["volume_mm3"]


def test_workers_do_not_import_the_report() -> None:
    """Every worker imports the module of its function; the report's charts would double the time for that."""
    modules = {getattr(value, "__module__", "") for value in vars(module).values()}
    assert "beltscape.reprocessing.measuring" in modules
    assert "beltscape.reprocessing.report" not in modules


def test_any_cut_counts_every_millimetre_once(moving_store, joined_store) -> None:
    whole, cut = read_result(moving_store), read_result(joined_store)
    assert (cut["recordings"], cut["pieces"]) == (3, 3)
    one, other = (read_records(store / "history") for store in (moving_store, joined_store))
    assert [record[1] for record in one] == [record[1] for record in other]
    sigma = whole["totals"]["sigma_mm3"]
    assert abs(whole["totals"]["volume_mm3"] - cut["totals"]["volume_mm3"]) < 0.3 * sigma
    assert cut["totals"]["sigma_mm3"] == pytest.approx(sigma, rel=0.05)


@pytest.mark.thorough
def test_two_workers_that_are_killed_give_the_ledger_of_one(reprocess, joined_store, tmp_path) -> None:
    ended, killed = threading.Event(), []
    killer = threading.Thread(target=_kill_workers, args=(ended, killed))
    killer.start()
    try:
        answer = reprocess("recordings", "--workers", 2)
    finally:
        ended.set()
        killer.join()
    assert answer["failed"] == []
    assert killed
    assert read_records(tmp_path / "store" / "history") == read_records(joined_store / "history")


def _kill_workers(ended: threading.Event, killed: list[int], most: int = 1) -> None:
    """Kill workers of this process, a tenth of a second after their begin at most."""
    while not ended.wait(0.1) and len(killed) < most:
        for process in find_workers():
            if process not in killed:
                os.kill(process, signal.SIGKILL)
                killed.append(process)
                break


def test_a_killed_run_goes_on_where_it_was(reprocess, recorded_plant, joined_store, tmp_path) -> None:
    store = tmp_path / "store"
    process = subprocess.Popen(
        [
            sys.executable, "-m", "beltscape", "reprocess", recorded_plant / "recordings",
            "--project", recorded_plant / "project.toml", "--out", store,
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )  # fmt: skip
    end = time.monotonic() + 180
    while _count_pieces(store) < 1:
        assert time.monotonic() < end
        assert process.poll() is None
        time.sleep(0.02)
    process.kill()
    process.wait()
    done = _count_pieces(store)
    answer = reprocess()
    assert answer["measured_now"] == 3 - done
    assert read_records(store / "history") == read_records(joined_store / "history")


def _count_pieces(store: Path) -> int:
    try:
        # closed at once: an open connection would lock the manifest for the run that goes on
        with closing(sqlite3.connect(f"file:{store / 'manifest.sqlite'}?mode=ro", uri=True)) as connection:
            return connection.execute("SELECT count(*) FROM pieces").fetchone()[0]
    except sqlite3.OperationalError:
        return 0


def test_damage_is_named_and_the_rest_is_measured(reprocess, recorded_plant, tmp_path) -> None:
    source = tmp_path / "source"
    source.mkdir()
    first, second, third = sorted((recorded_plant / "recordings" / "all").iterdir())
    for number, recording in enumerate((first, third)):
        with zipfile.ZipFile(source / f"2026-11-2{number}.zip", "w") as archive:
            for path in sorted(recording.rglob("*")):
                archive.write(path, f"{recording.name}/{path.relative_to(recording)}")
    cut = source / "2026-11-20.zip"
    cut.write_bytes(cut.read_bytes()[:-4000])  # the list of its members is at its end
    shutil.copytree(second, source / "day" / second.name)
    image = min((source / "day" / second.name / "cam1").iterdir())
    image.write_bytes(image.read_bytes()[:100])
    answer = reprocess(source)
    assert answer["recordings"] == 2
    assert [one["name"] for one in answer["unreadable"]] == ["2026-11-20.zip"]
    assert any(image.name in warning for warning in answer["findings"])
    lengths = answer["standings"]
    assert lengths["degraded"] > 0
    assert sum(lengths.values()) > FRAMES * STEP_MM * 2 / 3
