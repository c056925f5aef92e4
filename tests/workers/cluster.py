"""A local Ray cluster that the tests of a file share."""

from __future__ import annotations

import gc
import os
import secrets
import warnings
from collections.abc import Iterator

import pytest


def start_cluster() -> Iterator[None]:
    """Start a cluster of two workers, and stop it at the end; without Ray the tests are skipped."""
    # Ray turns tokens on by itself, but would keep a new one in the home folder
    os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))
    ray = pytest.importorskip(
        "ray", reason="Ray is not installed; pip install 'beltscape[cluster]' brings it"
    )
    ray.init(address="local", num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
    yield
    ray.shutdown()
    forget_processes()


def forget_processes() -> None:
    """Collect the handles of Ray's processes, whose end Ray does not wait for: they would warn in other tests."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        gc.collect()
