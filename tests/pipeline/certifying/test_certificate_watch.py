"""The certificate of the material test while a plant runs."""

from __future__ import annotations

import os

import pytest

from beltscape.core.progress import Silent
from beltscape.pipeline.certifying.certificates import CertificateWatch, IssueOptions, issue_certificate
from beltscape.pipeline.certifying.material_test import evaluate_test_file
from beltscape.service.project import open_project
from tests.pipeline.certifying.plants import make_tested_plant

NOW_MS = 1_795_000_000_000
DAY_MS = 86_400_000


def test_the_newest_certificate_is_read_when_the_folder_changes(tmp_path) -> None:
    plant, path = make_tested_plant(tmp_path / "plant")
    evaluated = evaluate_test_file(path, open_project(plant.path), Silent())
    data, now_ms, present = tmp_path / "data", NOW_MS, dict(evaluated.document["applies"])
    watch = CertificateWatch(data, lambda: now_ms)
    assert watch(present) is None
    issue_certificate(data, evaluated, IssueOptions("belt 4", "meier", NOW_MS, valid_days=30))
    reading = watch(present)
    assert reading is not None
    assert (reading.number, reading.in_force) == ("2026-0001", "2026-0001")
    assert reading.days_left == pytest.approx(30)
    changed = watch({**present, "rig": "f" * 64})
    assert changed is not None
    assert changed.changed == ("rig",)
    assert changed.in_force == ""
    now_ms += 31 * DAY_MS
    ended = watch(present)
    assert ended is not None
    assert ended.in_force == ""
    assert ended.days_left == pytest.approx(-1)
    issue_certificate(data, evaluated, IssueOptions("belt 4", "meier", now_ms))
    os.utime(data / "certificates")  # two changes within one tick of the file system's clock
    renewed = watch(present)
    assert renewed is not None
    assert renewed.in_force == "2026-0002"
