"""Modules of the tests that mount a disk of their own, run as programs."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

_ROOT = Path(__file__).parents[2]
_NAMESPACE = ["unshare", "--mount", "--map-root-user"]


def run_with_small_disk(module: str, folder: Path) -> dict[str, Any]:
    """Return the output of a module that may mount at ``folder``; the test is skipped without that right."""
    if not shutil.which("unshare") or _run([*_NAMESPACE, "true"]).returncode:
        pytest.skip("no mount namespace: unshare --mount is not allowed here")
    done = _run([*_NAMESPACE, sys.executable, "-m", module, str(folder)])
    if "mount:" in done.stderr:
        pytest.skip(f"no tmpfs here: {done.stderr.splitlines()[0]}")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def _run(command: list[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, cwd=_ROOT, check=False, capture_output=True, text=True, timeout=100)
