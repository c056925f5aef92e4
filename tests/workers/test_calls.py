"""Calls that others may make meanwhile: the same values and errors in any process."""

from __future__ import annotations

from pathlib import Path

import pytest

from beltscape.core.errors import InputError
from beltscape.workers.calls import CallMaker, CallsHere, CallsOfPool, make_call
from beltscape.workers.processes import open_process_pool
from tests.workers.functions import die_at_first, multiply


def test_the_value_and_the_error_do_not_depend_on_who_makes_the_call() -> None:
    with open_process_pool(make_call, None, 1) as pool:
        for calls in (CallsHere(), CallsOfPool(pool)):
            caller: CallMaker = calls
            assert caller.begin(multiply, 3, 4).result() == 12
    with pytest.raises(InputError, match="thirteen"):
        CallsHere().begin(multiply, 3, 13)
    with open_process_pool(make_call, None, 1) as pool:
        pending = CallsOfPool(pool).begin(multiply, 3, 13)
        with pytest.raises(InputError, match="thirteen"):
            pending.result()


def test_a_call_is_made_again_where_its_worker_dies(tmp_path: Path) -> None:
    deaths: list[str] = []
    with open_process_pool(make_call, None, 1, on_death=deaths.append) as pool:
        assert CallsOfPool(pool).begin(die_at_first, str(tmp_path), 7).result() == 7
    assert len(deaths) == 1
    assert deaths[0].startswith("die_at_first: the worker that ran it ended by signal 9")
