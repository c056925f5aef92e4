"""``beltscape cameras``: its summary and its refusals."""

from __future__ import annotations

import pytest

from beltscape.cli.commands import cameras
from beltscape.core.errors import InputError
from beltscape.core.progress import Silent

FOUND = {
    "device": "Basler-21730563",
    "model": "acA1920",
    "maker": "Basler",
    "address": "192.168.10.11",
    "serial": "21730563",
    "protocol": "GigEVision",
    "size_px": (1920, 1200),
    "formats": ("Mono12p", "Mono8"),
    "triggers": ("Line1", "Software"),
    "trouble": "",
}


def parsed(*words: str):
    import argparse

    parser = argparse.ArgumentParser()
    cameras.add_arguments(parser)
    return parser.parse_args(words)


def test_summary_states_the_required_settings():
    check = {"cam0": "", "cam1": "no camera 10.0.0.9 answers"}
    applied = {"cam0": {"exposure_us": 1200.0, "gain_db": None}}
    text = cameras.summary({"cameras": [FOUND], "check": check, "applied": applied})
    assert "Basler-21730563" in text
    assert "192.168.10.11" in text
    assert "1920×1200 px, Mono12p, Mono8" in text
    assert "fits, exposure 1200 µs" in text
    assert "no camera 10.0.0.9 answers" in text


def test_summary_without_cameras_states_the_fix():
    assert "power and cables" in cameras.summary({"cameras": [], "check": {}})


def test_project_without_cameras_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("beltscape.sources.genicam.aravis.find_cameras", list)
    (tmp_path / "project.toml").write_text("[web]\n")
    with pytest.raises(InputError, match=r"it has no table \[cameras\]"):
        cameras.run(parsed("--check", str(tmp_path / "project.toml")), Silent())
