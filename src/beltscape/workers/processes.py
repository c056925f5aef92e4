"""Tasks on processes of this machine, which begin and end with the pool and share memory with this one.

A process has its own interpreter, so that processes do not wait for each other's lock. One that dies is replaced, and
its task runs again.
"""

from __future__ import annotations

import itertools
import math
import os
import pickle
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from statistics import median
from typing import Any

from beltscape.core.system_calls import CORES, make_shared_file
from beltscape.workers.call import Completed
from beltscape.workers.transport import Block, receive, send

_DEATHS = 3
"""Deaths of its worker after which a task is given up: by then the task kills the worker, not chance."""
_THREADS = "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"
"""Variables of the environment from which libraries of linear algebra take their number of threads."""
_EXIT_S = 10.0
"""Longest wait for the end of a process whose pipe has ended already."""

_RECENT = 64
"""Tasks that ended last, by which the time of one is estimated."""
_LEAST_S = 1e-6
"""Shortest time of a task that is counted: clocks have a step."""

OnDeath = Callable[[str], object]
"""Receives a line on a worker that died and was replaced."""


class WorkerProcess:
    """One process that runs tasks of one function."""

    def __init__(self, function: Callable[[Any, Any], Any], shared: Any, threads: int) -> None:
        """Begin the process; it takes at most ``threads`` cores."""
        self._lock, self._how = threading.Lock(), ""
        self._tasks, self._ends = make_shared_file(), make_shared_file()
        command = [
            sys.executable,
            "-m",
            "beltscape.workers.worker_process",
            self._tasks.name,
            self._ends.name,
        ]
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | dict.fromkeys((CORES, *_THREADS), str(threads)),
            pass_fds=[file.inherited for file in (self._tasks, self._ends) if file.inherited is not None],
        )
        self._blocks = Block(self._tasks.file), Block(self._ends.file)
        with suppress(OSError):  # a process that has ended already is found by `run`
            # in the pipe alone: the first task may overwrite the block before the process has read this
            self._send((sys.path, pickle.dumps((function, shared))))

    @property
    def process_id(self) -> int:
        """Return the identity of the process."""
        return self._process.pid

    def run(self, number: int, task: Any) -> Completed[Any]:
        """Run a task and return its end; EOFError or OSError if the process dies meanwhile."""
        self._send((number, task))
        assert self._process.stdout is not None
        return receive(self._process.stdout, self._blocks[1], copied=True)

    def _send(self, value: object) -> None:
        assert self._process.stdin is not None
        send(self._process.stdin, self._blocks[0], value)

    def await_end(self) -> str:
        """Give up a process whose pipe has ended; return how it ended, in words."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_EXIT_S)
        return self.kill()

    def kill(self) -> str:
        """End the process, if it has not ended, and give its memory up; return how it ended, in words.

        It may be called again, from any thread.
        """
        with self._lock:
            if not self._how:
                self._how = self._end()
        return self._how

    def _end(self) -> str:
        ended = self._process.poll()
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        for block in self._blocks:
            block.close()
        for file in (self._tasks, self._ends):
            file.remove()
        if ended is None:
            return "stopped"
        return f"ended by signal {-ended}" if ended < 0 else f"ended with code {ended}"


class ProcessPool:
    """Runs the tasks of one function on processes; each thread of this process serves one."""

    def __init__(
        self,
        function: Callable[[Any, Any], Any],
        shared: Any,
        workers: int,
        *,
        threads: int = 1,
        on_death: OnDeath = lambda _: None,
        on_end: Callable[[], object] = lambda: None,
    ) -> None:
        """``threads`` is the number of cores that each worker may take; ``on_end`` is called after every task.

        Both ``on_death`` and ``on_end`` may be exchanged later.
        """
        self.workers = workers
        """Number of workers."""
        self.on_death, self.on_end = on_death, on_end
        self._begin_worker = lambda: WorkerProcess(function, shared, threads)
        self._lock, self._closed = threading.Lock(), False
        self._idle: deque[WorkerProcess] = deque()
        self._alive: set[WorkerProcess] = set()
        self._numbers = itertools.count()
        self._seconds: deque[float] = deque(maxlen=_RECENT)
        for _ in range(workers):  # they begin side by side
            self._idle.append(self._begin())
        self._threads = ThreadPoolExecutor(workers, "workers")

    def submit(self, task: Any, name: str) -> ProcessTask:
        """Hand out a task; see `tasks.TaskPool`."""
        future = self._threads.submit(self._run, next(self._numbers), task, name)
        future.add_done_callback(lambda _: self.on_end())
        return ProcessTask(future)

    def wait(self, pending: Sequence[ProcessTask]) -> list[ProcessTask]:
        """Return the tasks that have ended, of which there is one; see `tasks.TaskPool`."""
        wait([one.future for one in pending], return_when=FIRST_COMPLETED)
        return [one for one in pending if one.done()]

    def close(self) -> None:
        """Cancel what waits, and end all processes."""
        with self._lock:
            self._closed = True
            workers, self._alive = self._alive, set()
        for worker in workers:
            worker.kill()
        self._threads.shutdown(cancel_futures=True)

    def list_processes(self) -> list[int]:
        """Return the identities of the processes that run."""
        with self._lock:
            return sorted(worker.process_id for worker in self._alive)

    def count_tasks_per_s(self) -> float:
        """Return how many tasks the workers together run in a second, by those that ended last; inf before any."""
        seconds = list(self._seconds)
        return self.workers / median(seconds) if seconds else math.inf

    def _begin(self) -> WorkerProcess:
        worker = self._begin_worker()
        with self._lock:
            if not self._closed:
                self._alive.add(worker)
                return worker
        worker.kill()
        return worker

    def _run(self, number: int, task: Any, name: str) -> Completed[Any]:
        worker, how = self._idle.popleft(), ""
        try:
            for _ in range(_DEATHS):
                try:
                    end = worker.run(number, task)
                    self._seconds.append(max(end.seconds, _LEAST_S))
                    return end
                except (OSError, EOFError):
                    with self._lock:
                        self._alive.discard(worker)
                        closed = self._closed
                    how = worker.await_end()
                    if closed:
                        return Completed(number, None, "its pool was closed", "", 0.0, 0.0)
                    self.on_death(f"{name}: the worker that ran it {how}; another one takes it")
                    worker = self._begin()
            return Completed(number, None, f"its worker {how}, {_DEATHS} times", "", 0.0, 0.0)
        finally:
            self._idle.append(worker)


class ProcessTask:
    """A task of a pool."""

    def __init__(self, future: Future[Completed[Any]]) -> None:
        self.future = future

    def result(self) -> Completed[Any]:
        """Return the task's end; see `tasks.PendingTask`."""
        return self.future.result()

    def done(self) -> bool:
        """Return whether the task has ended."""
        return self.future.done()


@contextmanager
def open_process_pool(
    function: Callable[[Any, Any], Any],
    shared: Any,
    workers: int,
    *,
    threads: int = 1,
    on_death: OnDeath = lambda _: None,
) -> Generator[ProcessPool]:
    """Yield a pool of processes, which end with it; see `ProcessPool`."""
    pool = ProcessPool(function, shared, workers, threads=threads, on_death=on_death)
    try:
        yield pool
    finally:
        pool.close()
