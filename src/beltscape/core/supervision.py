"""Supervised threads: a failure is logged and reported, and the work starts again."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

RESTART_S = 1.0
"""Pause before failed work starts again, so that a lasting fault does not occupy a processor."""


def describe_failure(error: BaseException) -> str:
    """Return an unexpected error in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


def supervise(
    work: Callable[[], None], on_failure: Callable[[str], None], wait_to_stop: Callable[[float], bool]
) -> None:
    """Call ``work`` until it returns; after an exception of any kind it is called again.

    ``on_failure`` is called with the error in one line; ``wait_to_stop`` waits for the given seconds and returns
    whether to stop, such as ``Event.wait``.
    """
    while True:
        try:
            work()
            return
        except Exception as error:
            _log_failure(error)
            on_failure(describe_failure(error))
        if wait_to_stop(RESTART_S):
            return


def make_supervised_thread(
    name: str,
    work: Callable[[], None],
    on_failure: Callable[[str], None],
    wait_to_stop: Callable[[float], bool],
) -> threading.Thread:
    """Return a daemon thread, not started, that runs ``work`` as ``supervise`` does."""
    return threading.Thread(target=supervise, args=(work, on_failure, wait_to_stop), name=name, daemon=True)


def log_uncaught_errors() -> None:
    """Log errors that end a thread which nothing supervises, such as one of a library."""

    def log(caught: threading.ExceptHookArgs) -> None:
        name = "a thread" if caught.thread is None else caught.thread.name
        if caught.exc_value is not None:
            logging.getLogger("beltscape").error("%s ended: %s", name, describe_failure(caught.exc_value))

    threading.excepthook = log


def _log_failure(error: Exception) -> None:
    log = logging.getLogger("beltscape")
    log.error("%s: %s; it starts again", threading.current_thread().name, describe_failure(error))
    log.debug("its origin", exc_info=error)
