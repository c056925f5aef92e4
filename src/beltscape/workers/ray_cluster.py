"""Tasks on a Ray cluster that runs already.

Each worker of a machine has a core of its own, so that its threads do not take those of other workers.
"""

from __future__ import annotations

import os
import socket
import tempfile
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import cv2

from beltscape import __version__
from beltscape.core.errors import SettingsError
from beltscape.core.system_calls import CORES, bind_to_free_core
from beltscape.workers.call import Completed, call
from beltscape.workers.options import WorkerOptions

_ANSWER_S = 5.0
"""Time in which a cluster's port must answer."""
_MODE, _TOKEN, _TOKEN_FILE = "RAY_AUTH_MODE", "RAY_AUTH_TOKEN", Path("~/.ray/auth_token")
"""Where Ray looks for its token (Ray's documentation, token authentication)."""


def _silence(ray: Any) -> None:
    """Keep Ray from printing on standard output, which belongs to the result."""
    ray._private.worker._worker_logs_enabled = False


def _probe(address: str) -> None:
    """Raise OSError if nothing listens at host:port; Ray itself would try for minutes."""
    host, separator, port = address.removeprefix("ray://").rpartition(":")
    if separator and port.isdigit():
        socket.create_connection((host, int(port)), _ANSWER_S).close()


def _set_authentication() -> None:
    """Choose, before Ray is imported, that it gives a cluster the user's token where there is one.

    The environment may say otherwise; clusters without tokens ignore it.
    """
    if _MODE in os.environ:
        return
    if _TOKEN in os.environ or f"{_TOKEN}_PATH" in os.environ or _TOKEN_FILE.expanduser().is_file():
        os.environ[_MODE] = "token"


@contextmanager
def connect(options: WorkerOptions) -> Generator[Any]:
    """Yield Ray, connected to the cluster.

    Raises
    ------
    SettingsError
        When Ray is not installed, or the cluster does not answer.
    """
    assert options.address is not None
    _set_authentication()
    try:
        ray: Any = import_module("ray")
    except ImportError as error:
        raise SettingsError(
            "a cluster needs Ray, which is not installed; pip install 'beltscape[cluster]', or leave out "
            "--address"
        ) from error
    _silence(ray)
    if ray.is_initialized():
        yield ray
        return
    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    try:
        _probe(options.address)
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


@cache
def take_core() -> int | None:
    """Keep this process, until it ends, to a core that no other worker of this user has; return its number.

    Without a free core, and on systems that do not bind processes to cores, only the number of threads is limited.
    """
    os.environ[CORES] = "1"
    cv2.setNumThreads(1)
    return bind_to_free_core(Path(tempfile.gettempdir()))


_RETRIES = 10
"""Number of deaths of its worker after which a task is given up: by then the task kills the worker, not chance."""
_POLL_S = 1.0
"""Time after which the cluster's size is looked at again."""


@contextmanager
def open_ray_pool(
    function: Callable[[Any, Any], Any], shared: Any, options: WorkerOptions
) -> Generator[RayPool]:
    """Yield a pool of a cluster's workers; see `tasks.open_pool`."""
    with connect(options) as ray:
        pool = RayPool(ray, function, shared, options)
        try:
            yield pool
        finally:
            for reference in pool.running:
                ray.cancel(reference, force=True)


class RayPool:
    """Runs the tasks of one function on the workers of a cluster."""

    def __init__(
        self, ray: Any, function: Callable[[Any, Any], Any], shared: Any, options: WorkerOptions
    ) -> None:
        self._ray, self._options, self._count = ray, options, 0
        self._remote = ray.remote(num_cpus=1, max_retries=_RETRIES, retry_exceptions=False)(_call_on_worker)
        self._everywhere = ray.put((__version__, function, shared))
        self.running: dict[Any, int] = {}
        """Reference → number of every task whose end was not taken yet."""

    @property
    def workers(self) -> int:
        """Return the present number of workers; nodes come and go."""
        cores, most = int(self._ray.cluster_resources().get("CPU", 1)), self._options.workers
        return max(1, cores if most is None else min(cores, most))

    def submit(self, task: Any, name: str) -> _RayTask:
        """Hand out a task; see `tasks.TaskPool`."""
        reference = self._remote.options(name=name).remote(self._everywhere, self._count, task)
        self.running[reference] = self._count
        self._count += 1
        return _RayTask(self, reference)

    def wait(self, pending: Sequence[_RayTask]) -> list[_RayTask]:
        """Return a task that ends before the cluster's size is looked at again, if any; see `tasks.TaskPool`."""
        ended = self._ray.wait([one.reference for one in pending], num_returns=1, timeout=_POLL_S)[0]
        return [one for one in pending if one.reference in ended]

    def has_ended(self, reference: Any) -> bool:
        """Return whether a task has ended, or was taken already."""
        return reference not in self.running or bool(self._ray.wait([reference], timeout=0)[0])

    def take(self, reference: Any) -> Completed[Any]:
        """Wait for the end of a task that was run, or whose workers died."""
        number = self.running.pop(reference)
        try:
            return self._ray.get(reference)
        except self._ray.exceptions.RayTaskError as error:
            # the function's own failures are values: this is the call around it
            raise SettingsError(str(error.cause).splitlines()[0]) from error
        except self._ray.exceptions.RayError as error:
            has_crashed = isinstance(error, self._ray.exceptions.WorkerCrashedError)
            what = f"its worker died {_RETRIES + 1} times" if has_crashed else "the cluster was lost"
            return Completed(number, None, f"{what} ({type(error).__name__})", "", 0.0, 0.0)


class _RayTask:
    """A task of a pool."""

    def __init__(self, pool: RayPool, reference: Any) -> None:
        self._pool, self.reference = pool, reference

    def result(self) -> Completed[Any]:
        """Return the task's end; see `tasks.PendingTask`."""
        return self._pool.take(self.reference)

    def done(self) -> bool:
        """Return whether the task has ended."""
        return self._pool.has_ended(self.reference)


def _call_on_worker(everywhere: tuple[str, Any, Any], number: int, task: Any) -> Completed[Any]:
    """Run a task on a worker that has the driver's version of the program, on one core."""
    version, function, shared = everywhere
    if version != __version__:
        raise SettingsError(
            f"a worker has Beltscape {__version__}, this machine has {version}; install one version on all"
        )
    take_core()
    return call(function, shared, number, task)
