"""Calls that others may make meanwhile: the same values and errors, whoever makes them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from beltscape.core.errors import InputError
from beltscape.workers.calls import Call, CallMaker, CallsHere, CallsOfPool
from beltscape.workers.processes import open_process_pool
from tests.workers.functions import die_at_first, multiply, note_order


def make(shared: None, task: Call[Any]) -> Any:
    """Make a call, as the function of a pool."""
    del shared
    return task.make()


def test_the_value_and_the_error_do_not_depend_on_who_makes_the_call() -> None:
    with open_process_pool(make, None, 1) as pool:
        for calls in (CallsHere(), CallsOfPool(pool)):
            caller: CallMaker = calls
            assert caller.begin(multiply, 3, 4).result() == 12
    with pytest.raises(InputError, match="thirteen"):
        CallsHere().begin(multiply, 3, 13)
    with open_process_pool(make, None, 1) as pool:
        pending = CallsOfPool(pool).begin(multiply, 3, 13)
        with pytest.raises(InputError, match="thirteen"):
            pending.result()


def test_a_call_is_made_again_where_its_worker_dies(tmp_path: Path) -> None:
    deaths: list[str] = []
    with open_process_pool(make, None, 1, on_death=deaths.append) as pool:
        assert CallsOfPool(pool).begin(die_at_first, str(tmp_path), 7).result() == 7
    assert len(deaths) == 1
    assert deaths[0].startswith("die_at_first: the worker that ran it ended by signal 9")


def test_calls_are_made_before_the_tasks_that_wait(tmp_path: Path) -> None:
    order, go_on = tmp_path / "order", tmp_path / "go_on"
    with open_process_pool(make, None, 1) as pool:
        first = pool.submit(Call(note_order, (str(order), "first", str(go_on))), "first")
        tasks = [pool.submit(Call(note_order, (str(order), str(k), "")), str(k)) for k in range(2)]
        call = CallsOfPool(pool).begin(note_order, str(order), "call", "")
        go_on.touch()
        for one in (first, *tasks, call):
            one.result()
        assert pool.count_tasks_per_s() > 0
    assert order.read_text().split() == ["first", "call", "0", "1"]
