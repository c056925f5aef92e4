"""A local Ray cluster that the tests of a file share."""

from __future__ import annotations

import gc
import warnings
from collections.abc import Iterator

import pytest

from beltscape.workers.ray_cluster import set_authentication


def start_cluster() -> Iterator[None]:
    """Start a cluster of two workers, and stop it at the end; without Ray the tests are skipped."""
    set_authentication(None)
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
