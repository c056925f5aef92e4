"""The native kernels read a record's fields by their names, and refuse a record that is not theirs."""

from __future__ import annotations

from collections import namedtuple
from typing import Any

import numpy as np
import pytest

from beltscape.kernels.geometry import VisibleInput
from beltscape.kernels.images import GatherInput
from beltscape.kernels.native import NativeBackend, levels
from tests.kernels.grids import surface, view_of_seed

SHAPE = 6, 8
VISIBLE = VisibleInput(surface(1, *SHAPE), view_of_seed(1), np.zeros(SHAPE, np.float32), 0.5)
GATHER = GatherInput(
    [np.ones(SHAPE, np.float32)],
    np.arange(3, dtype=np.float32),
    np.arange(3, dtype=np.float32),
    np.zeros((1, 2), np.int32),
)

pytestmark = pytest.mark.parametrize("level", levels())


def run_visible(level: str, record: Any, out: np.ndarray | None = None) -> np.ndarray:
    out = np.empty(SHAPE, np.uint8) if out is None else out
    return NativeBackend(level).run("visible", record, (out,), 1)[0]


def run_gather(level: str, record: Any) -> None:
    NativeBackend(level).run("gather", record, (np.empty((1, 3), np.float32),), 1)


def test_fields_are_read_by_name_in_any_order(level):
    reordered = namedtuple("Reordered", reversed(VISIBLE._fields))(*reversed(VISIBLE))  # pyrefly: ignore[bad-class-definition]
    np.testing.assert_array_equal(run_visible(level, reordered), run_visible(level, VISIBLE))


def test_a_record_without_a_field_is_refused(level):
    record = namedtuple("Short", VISIBLE._fields[:-1])(*VISIBLE[:-1])  # pyrefly: ignore[bad-class-definition]
    with pytest.raises(
        TypeError, match="visible: the input must be a record with the field tolerance, not Short"
    ):
        run_visible(level, record)


def test_a_record_with_an_unread_field_is_refused(level):
    record = namedtuple("Long", (*VISIBLE._fields, "gate"))(*VISIBLE, 1.0)
    with pytest.raises(
        TypeError, match="the input must be a record of the 4 fields in the kernel's header, not Long"
    ):
        run_visible(level, record)


def test_what_is_no_record_is_refused(level):
    with pytest.raises(TypeError, match="visible: the input must be a NamedTuple, not dict"):
        run_visible(level, VISIBLE._asdict())


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("s", VISIBLE.s.astype(np.float64), r"s must be .*float32.*, not float64 \(6, 8\)"),
        ("s", VISIBLE.s[0], r"s must be .*, not float32 \(8,\)"),
        ("s", VISIBLE.s[:, ::2], r"s must be a contiguous .*, not float32 \(6, 4\)"),
        ("s", None, r"s must be .*, not NoneType"),
        ("view", VISIBLE.view[:20], r"view must be .*39.*, not float32 \(20,\)"),
        ("tolerance", "near", "tolerance must be a number, not str"),
    ],
)
def test_a_field_of_another_type_is_refused_by_name(level, field, value, message):
    with pytest.raises(TypeError, match=f"visible: {message}"):
        run_visible(level, VISIBLE._replace(**{field: value}))


def test_an_item_of_a_list_is_refused_by_its_number(level):
    planes = [GATHER.planes[0], GATHER.planes[0].astype(np.uint8)]
    with pytest.raises(TypeError, match=r"gather: planes\[1\] must be .*, not uint8 \(6, 8\)"):
        run_gather(level, GATHER._replace(planes=planes))  # pyrefly: ignore[bad-argument-type]
    with pytest.raises(TypeError, match="gather: planes must be a list, not int"):
        run_gather(level, GATHER._replace(planes=3))  # pyrefly: ignore[bad-argument-type]


def test_a_result_of_another_type_is_refused(level):
    with pytest.raises(TypeError, match=r"visible: results\[0\] must be .*, not float32"):
        run_visible(level, VISIBLE, np.empty(SHAPE, np.float32))
    fixed = np.empty(SHAPE, np.uint8)
    fixed.flags.writeable = False
    with pytest.raises(TypeError, match=r"visible: results\[0\] must be"):
        run_visible(level, VISIBLE, fixed)
    with pytest.raises(TypeError, match="visible: results must be 1 arrays, not tuple"):
        NativeBackend(level).run("visible", VISIBLE, (fixed, fixed), 1)
