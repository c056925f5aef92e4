"""Shared objects: objects that many tasks hold are unpickled once in the process that receives them."""

from __future__ import annotations

import pickle

import numpy as np

from beltscape.workers import transport
from beltscape.workers.transport import SharedObject


class Counted:
    """Counts how often it is pickled."""

    pickled = 0

    def __init__(self, value: float) -> None:
        self.plane = np.full(3, value)

    def __getstate__(self) -> dict[str, object]:
        Counted.pickled += 1
        return {"plane": self.plane}


def send(shared: SharedObject[Counted]) -> SharedObject[Counted]:
    return pickle.loads(pickle.dumps({"task": shared}))["task"]


def test_a_shared_object_is_pickled_once_and_received_as_the_same_object() -> None:
    Counted.pickled = 0
    shared = SharedObject(Counted(1.5))
    first, second = send(shared), send(shared)
    assert first.value is second.value is not shared.value
    assert first.value.plane.tolist() == [1.5] * 3
    assert Counted.pickled == 1
    assert send(first).value is first.value  # sent on
    assert Counted.pickled == 1


def test_shared_objects_with_other_content_are_other_objects_and_the_oldest_go() -> None:
    shared_objects = [SharedObject(Counted(k)) for k in range(transport._KEPT + 1)]
    received = [send(shared).value for shared in shared_objects]
    assert [one.plane[0] for one in received] == list(range(len(shared_objects)))
    assert send(shared_objects[-1]).value is received[-1]
    assert send(shared_objects[0]).value is not received[0]
    assert len(transport._unpacked) == transport._KEPT
