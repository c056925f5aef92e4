"""The script that collects wheels for a machine with a GPU and without a network."""

from __future__ import annotations

import hashlib
import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "tools" / "collect_gpu_wheels.sh"
PIP = """#!/bin/sh
# in place of a Python with pip: notes its words and the locks, and downloads one file
echo "$@" >"$NOTES/words"
while [ $# -gt 0 ]; do
  case $1 in
    --dest) folder=$2 ;;
    -r) cat "$2" >>"$NOTES/locks" ;;
  esac
  shift
done
echo numpy >"$folder/numpy-2.0-cp312-any.whl"
"""


def collect(tmp_path: Path, *arguments: Path) -> subprocess.CompletedProcess[str]:
    python = tmp_path / "python"
    python.write_text(PIP)
    python.chmod(0o755)
    environment = {**os.environ, "PYTHON": str(python), "NOTES": str(tmp_path)}
    return subprocess.run(
        ["sh", str(SCRIPT), *map(str, arguments)],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


def test_all_that_the_script_of_graphics_processors_installs_is_collected_from_the_locks(tmp_path):
    wheel, folder = tmp_path / "beltscape-1-py3-none-any.whl", tmp_path / "wheels"
    wheel.write_bytes(b"beltscape")
    done = collect(tmp_path, wheel, folder)
    assert (done.returncode, done.stdout) == (0, "2 wheels, 0 MB\n"), done.stderr
    listed = [line.split() for line in (folder / "list.txt").read_text().splitlines()]
    assert [each[2] for each in listed] == sorted(path.name for path in folder.glob("*.whl"))
    for digest, size, name in listed:
        data = (folder / name).read_bytes()
        assert (digest, int(size)) == (hashlib.sha256(data).hexdigest(), len(data))
    words, locks = (tmp_path / "words").read_text(), (tmp_path / "locks").read_text()
    assert words.startswith("-m pip download --quiet --only-binary=:all: --require-hashes --dest")
    pinned = {line.partition("==")[0] for line in locks.splitlines() if "==" in line}
    assert {
        "numpy",
        "cuda-core",
        "pytest",
        "pytest-xdist",
        "execnet",
        "hypothesis",
        "sortedcontainers",
    } <= pinned
    assert (ROOT / "requirements" / "gpu.lock").read_text() in locks


@pytest.mark.parametrize("given", [(), ("no.whl",), ("a", "b", "c")])
def test_other_arguments_are_answered_with_the_usage(tmp_path, given):
    done = collect(tmp_path, *map(Path, given))
    assert (done.returncode, done.stderr) == (2, "usage: tools/collect_gpu_wheels.sh WHEEL FOLDER\n")
    assert not (tmp_path / "words").exists()


def test_a_wheel_that_is_not_there_ends_the_script_before_anything_is_downloaded(tmp_path):
    done = collect(tmp_path, tmp_path / "no.whl", tmp_path / "wheels")
    assert (done.returncode, done.stderr) == (2, f"there is no wheel {tmp_path}/no.whl; run: make wheel\n")
    assert not (tmp_path / "words").exists()


def test_the_script_that_measures_names_it():
    assert "tools/collect_gpu_wheels.sh" in (ROOT / "benchmarks" / "gpu.sh").read_text()
