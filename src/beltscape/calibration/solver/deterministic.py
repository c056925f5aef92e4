"""Deterministic solvers: OpenCV and BLAS restricted to one thread, for the same digits on any number of cores."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager

import cv2
from threadpoolctl import threadpool_limits


@contextmanager
def single_thread() -> Generator[None]:
    """Run OpenCV and BLAS on one thread: the last digits of parallel sums depend on the number of threads.

    The matrices are small, so one thread is also the fastest.
    """
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with threadpool_limits(limits=1, user_api="blas"):
            yield
    finally:
        cv2.setNumThreads(before)
