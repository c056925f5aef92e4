"""Tasks on workers: in this process, on processes, and on a Ray cluster, with failures and killed workers."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import pytest

from beltscape.core.errors import InputError, SettingsError
from beltscape.workers.options import WorkerOptions
from beltscape.workers.tasks import collect_values, run_tasks
from tests.thorough import THOROUGH, list_cases
from tests.workers.cluster import start_cluster
from tests.workers.functions import count_cores, die_at_first, multiply, sleep

HERE, TWO = WorkerOptions(), WorkerOptions(workers=2)
CLUSTER = WorkerOptions(workers=2, address="auto")


@pytest.fixture
def cluster() -> Iterator[None]:
    """A local cluster; starting it takes seconds, so that one test does all that needs it."""
    yield from start_cluster()


def test_tasks_here_run_in_order_and_a_failure_is_one_tasks_own() -> None:
    ends = list(run_tasks(multiply, 2, [1, 13, 14, 3], HERE))
    assert [end.number for end in ends] == [0, 1, 2, 3]
    assert [end.value for end in ends] == [2, None, None, 6]
    assert ends[1].failure == "thirteen.png: the file is damaged; copy the image again"
    assert ends[2].failure == "ZeroDivisionError: division"


def test_a_cluster_that_does_not_answer_is_named() -> None:
    pytest.importorskip("ray", reason="Ray is not installed; pip install 'beltscape[cluster]' brings it")
    with pytest.raises(SettingsError, match=r"127\.0\.0\.1:1: no Ray cluster answers"):
        list(run_tasks(multiply, 2, [1], WorkerOptions(address="127.0.0.1:1")))


def test_two_processes_give_the_same_values() -> None:
    compare_values(TWO)


def test_a_cluster_gives_the_same_values_repeats_lost_tasks_and_cancels(cluster: None, tmp_path) -> None:
    compare_values(CLUSTER)
    count = 4 if THOROUGH else 1  # a worker dies at each task's first try
    ends = list(run_tasks(die_at_first, str(tmp_path), [*range(count)], CLUSTER))
    assert sorted(end.value for end in ends if end.value is not None) == [*range(count)]
    slow = run_tasks(sleep, 0.1, [*range(50)], CLUSTER)
    assert next(slow).value is not None
    slow.close()  # what is not wanted any more is cancelled
    assert len(list(run_tasks(multiply, 3, [1, 2], CLUSTER))) == 2
    (cores,) = collect_values(count_cores, None, [None], CLUSTER, lambda _: None)
    assert cores == (1, 1, "1"), "a worker has one core"


def compare_values(options: WorkerOptions) -> None:
    ends = sorted(run_tasks(multiply, 2, [*range(20)], options), key=lambda end: end.number)
    assert [end.value for end in ends] == [end.value for end in run_tasks(multiply, 2, [*range(20)], HERE)]
    assert [end.failure for end in ends if end.value is None] == [
        "thirteen.png: the file is damaged; copy the image again",
        "ZeroDivisionError: division",
    ]


@pytest.mark.thorough
@pytest.mark.parametrize("options", [TWO, CLUSTER], ids=str)
def test_two_tasks_run_at_a_time(cluster: None, options) -> None:
    ends = list(run_tasks(sleep, 0.2, [*range(6)], options))
    assert len({end.worker for end in ends}) == 2
    begins = sorted((end.begin_s, end.begin_s + end.seconds) for end in ends)
    assert any(second[0] < first[1] for first, second in itertools.pairwise(begins))


@pytest.mark.parametrize("workers", list_cases([0, -1, 100_000], [0, 100_000]))
def test_an_impossible_number_of_workers_is_refused(workers: int) -> None:
    with pytest.raises(SettingsError, match="--workers"):
        WorkerOptions(workers=workers)


def test_without_ray_the_fix_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(SettingsError, match=r"pip install 'beltscape\[cluster\]'"):
        list(run_tasks(multiply, 2, [1], CLUSTER))


@pytest.mark.parametrize("options", [HERE, TWO], ids=str)
def test_values_that_are_all_needed_come_in_order_or_as_the_error_of_one(options) -> None:
    counts: list[int] = []
    assert collect_values(multiply, 2, [3, 1, 2], options, counts.append) == [6, 2, 4]
    assert counts == [0, 1, 2, 3]
    with pytest.raises(InputError, match=r"^thirteen\.png: the file is damaged"):
        collect_values(multiply, 2, [3, 13, 1], options, counts.append)
    with pytest.raises(ZeroDivisionError):
        collect_values(multiply, 2, [14], options, counts.append)
