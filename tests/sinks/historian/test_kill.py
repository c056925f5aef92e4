"""The historian under killed writers: nothing acknowledged is lost."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
KILLS, LEAST = 36, 6 * 96
"""Records, those of six days: of all days but the newest ones there are files, however few a busy machine writes."""


@pytest.mark.thorough
def test_nothing_acknowledged_is_lost_by_killing(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "tests.sinks.historian.killed_writer", str(tmp_path), str(KILLS), str(LEAST)],
        cwd=ROOT,
        check=False,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["acknowledged"] >= LEAST
    # what was written but not yet acknowledged may be there: one batch at most
    assert 0 <= found["records"] - found["acknowledged"] <= 4
    assert found["runs"] > KILLS // 2
    assert found["numbers"] and found["contiguous"] and found["same"]
    assert found["resume"] == [found["records"], found["end_mm"]]
    total, *volumes = found["volumes_mm3"]
    assert total == math.fsum(volumes)
    length, *lengths = found["lengths_mm"]
    assert length == pytest.approx(math.fsum(lengths), rel=1e-14)
    assert found["curves"] == [pytest.approx(total), found["records"]]
    filed, once = found["filed"]
    assert filed == once > found["records"] // 2
    assert found["integrity"] == "ok"
    assert found["repairs"] == ""
