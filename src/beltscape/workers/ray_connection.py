"""The connection to a Ray cluster: one that runs already, or one of this machine."""

from __future__ import annotations

import os
import secrets
import socket
from collections.abc import Generator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from beltscape.core.errors import SettingsError
from beltscape.workers.options import WorkerOptions

_ANSWER_S = 5.0
"""Time in which a cluster's port must answer."""
_MODE, _TOKEN, _TOKEN_FILE = "RAY_AUTH_MODE", "RAY_AUTH_TOKEN", Path("~/.ray/auth_token")
"""Where Ray looks for its token (Ray's documentation, token authentication)."""


def _silence(ray: Any) -> None:
    """Keep Ray from printing on standard output, which belongs to the result."""
    ray._private.worker._worker_logs_enabled = False


def _probe(address: str | None) -> None:
    """Raise OSError if nothing listens at host:port; Ray itself would try for minutes."""
    host, separator, port = (address or "").removeprefix("ray://").rpartition(":")
    if separator and port.isdigit():
        socket.create_connection((host, int(port)), _ANSWER_S).close()


def set_authentication(address: str | None) -> None:
    """Choose Ray's token, before Ray is imported, where the environment does not: without a trace in the home folder.

    A cluster of this machine has a token of its own, so that no other user can run code on it. A cluster that runs
    already gets the user's token, if there is one; clusters without tokens ignore it.
    """
    if _MODE in os.environ:
        return
    if address is None:  # Ray turns tokens on by itself, but would keep a new one in the home folder
        os.environ.setdefault(_TOKEN, secrets.token_hex(32))
    elif _TOKEN in os.environ or f"{_TOKEN}_PATH" in os.environ or _TOKEN_FILE.expanduser().is_file():
        os.environ[_MODE] = "token"


@contextmanager
def connect(options: WorkerOptions) -> Generator[Any]:
    """Yield Ray, connected to the cluster, or to one of this machine that ends with it.

    Raises
    ------
    SettingsError
        When Ray is not installed, or the cluster does not answer.
    """
    set_authentication(options.address)
    try:
        ray: Any = import_module("ray")
    except ImportError as error:
        raise SettingsError(
            "several workers need Ray, which is not installed; pip install 'beltscape[cluster]', or leave out "
            "--workers and --address"
        ) from error
    _silence(ray)
    if ray.is_initialized():
        yield ray
        return
    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    try:
        _probe(options.address)
        if options.address is None:
            ray.init(address="local", num_cpus=options.workers, include_dashboard=False, **quiet)
        else:
            ray.init(address=options.address, **quiet)
    except (ConnectionError, OSError, RuntimeError, ValueError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise SettingsError(
            f"--address {options.address}: no Ray cluster answers ({reason}); start one with ray start "
            "--head; if it has a token, set RAY_AUTH_MODE=token and RAY_AUTH_TOKEN"
        ) from error
    try:
        yield ray
    finally:
        ray.shutdown()
