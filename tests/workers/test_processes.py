"""Tasks on processes of this machine: arrays through shared memory, killed workers, and ends of pools."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from beltscape.workers.options import WorkerOptions
from beltscape.workers.processes import open_process_pool
from beltscape.workers.tasks import run_tasks
from tests.protocols.broker import wait_until
from tests.workers.functions import add_arrays, count_cores, die_always, die_at_first, multiply, sleep
from tests.workers.processes import is_running


def test_arrays_of_any_size_and_order_come_back_as_the_functions_own() -> None:
    rng = np.random.default_rng(0)
    with open_process_pool(add_arrays, np.float32(2), 1) as pool:
        # the second task needs more memory than the first, the third less
        for shape in ((3, 4), (700, 900, 3), (0, 5), (10, 10)):
            given = {"one": rng.random(shape, np.float32), "other": np.asfortranarray(rng.random(shape))}
            end = pool.submit(given, "sum").result()
            assert end.value is not None, end.failure
            total, was_writeable = end.value
            np.testing.assert_array_equal(total, given["one"] + given["other"] + np.float32(2))
            total += 1  # the caller's own
            assert not was_writeable or not total.size


def test_what_tasks_share_is_not_overwritten_by_the_first_task() -> None:
    shared = np.arange(200_000.0)
    with open_process_pool(add_arrays, shared, 1) as pool:
        end = pool.submit({"one": np.zeros(200_000)}, "sum").result()
    np.testing.assert_array_equal(end.value[0], shared)  # pyrefly: ignore[unsupported-operation]


def test_a_result_outlives_the_pool_and_the_tasks_after_it() -> None:
    with open_process_pool(add_arrays, 0, 1) as pool:
        ends = [pool.submit({"one": np.full((400, 400), float(k))}, "sum") for k in range(4)]
        totals = [end.result().value[0] for end in ends]  # pyrefly: ignore[unsupported-operation]
    assert [float(total.mean()) for total in totals] == [0.0, 1.0, 2.0, 3.0]


def test_a_worker_that_dies_is_replaced_and_named(tmp_path: Path) -> None:
    lines: list[str] = []
    with open_process_pool(die_at_first, str(tmp_path), 1, on_death=lines.append) as pool:
        before = pool.list_processes()
        assert pool.submit(7, "frame 7").result().value == 7
        assert pool.list_processes() != before
    assert lines == ["frame 7: the worker that ran it ended by signal 9; another one takes it"]


def test_a_worker_killed_between_two_tasks_loses_none() -> None:
    with open_process_pool(multiply, 2, 2) as pool:
        for process in pool.list_processes():
            os.kill(process, signal.SIGKILL)
        assert [pool.submit(k, str(k)).result().value for k in range(4)] == [0, 2, 4, 6]


def test_a_task_that_kills_every_worker_is_given_up() -> None:
    with open_process_pool(die_always, None, 1) as pool:
        end = pool.submit(0, "frame").result()
        assert end.value is None and end.failure == "its worker ended by signal 9, 3 times"
        assert pool.submit(1, "frame").result().value is None


def test_processes_end_with_their_pool_even_in_a_task() -> None:
    with open_process_pool(sleep, 600.0, 2) as pool:
        tasks = [pool.submit(k, str(k)) for k in range(3)]
        processes = pool.list_processes()
        wait_until(tasks[0].future.running, 60)
    assert not any(map(is_running, processes))


def test_processes_end_with_the_program_that_began_them(tmp_path: Path) -> None:
    code = (
        "from beltscape.workers.processes import ProcessPool\n"
        "from tests.workers.functions import multiply\n"
        "import os, signal\n"
        "pool = ProcessPool(multiply, 2, 2)\n"
        "assert pool.submit(1, 'one').result().value == 2\n"
        "print(*pool.list_processes(), flush=True)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    processes = [int(number) for number in done.stdout.split()]
    assert len(processes) == 2, done.stderr
    wait_until(lambda: not any(map(is_running, processes)), 60)


def test_a_worker_takes_as_many_cores_as_it_is_given() -> None:
    with open_process_pool(count_cores, None, 1) as pool:
        assert pool.submit(None, "cores").result().value == (1, 1, "1")


@pytest.mark.parametrize("workers", [1, 3])
def test_what_is_not_wanted_any_more_is_cancelled(workers: int) -> None:
    ends = run_tasks(sleep, 0.05, [*range(50)], WorkerOptions(workers=workers))
    assert next(ends).value is not None
    ends.close()
