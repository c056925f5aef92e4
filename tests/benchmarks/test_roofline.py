"""The roofline of the kernels: bytes, operations, and a table of a whole frame."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np
import pytest

from beltscape.kernels import networks
from tests.synthetic.demo import write_demo

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(autouse=True)
def _path(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))


def test_operations_of_networks_are_exact():
    operations = importlib.import_module("matching.operations").OPERATIONS

    layers = [np.zeros((3, 5), np.float32), np.zeros((2, 4), np.float32)]  # 4 inputs, 3 units, 2 outputs
    planes = [np.zeros((2, 7), np.float32)] * 4
    given = networks.NetworkInput(planes, np.zeros((2, 4), np.float32), layers)
    per_pixel = 2 * 3 * 4 + 3 + 2 * 2 * 3
    assert operations["evaluate_network"](given, ()) == 14 * (per_pixel + 2 * 4)
    senders = np.zeros((9, 5), np.int32)
    passed = networks.MessagePassingInput(
        np.zeros((1, 6), np.float32), senders, np.zeros((1, 5), np.float32), layers
    )
    assert operations["pass_messages"](passed, ()) == 5 * per_pixel


def test_bytes_count_each_array_once_and_of_planes_what_is_read():
    count_bytes = importlib.import_module("roofline").count_bytes

    plane, pixels = np.zeros((10, 20), np.float32), np.zeros(3, np.float32)
    assert count_bytes((plane, [plane, pixels], 1.5)) == plane.nbytes + pixels.nbytes
    assert count_bytes((plane, pixels), len(pixels)) == 2 * pixels.nbytes


def test_table_has_every_kernel_of_a_frame(monkeypatch, tmp_path):
    write_demo(tmp_path, scenes=["belt_empty"])
    roofline = importlib.import_module("roofline")
    monkeypatch.setattr(roofline, "_RUNS", 1)
    work, frame_s = roofline.measure_frame(tmp_path / "belt_empty", tmp_path / "truth" / "rig.json", "fast")
    assert {"sweep_and_aggregate", "propagate", "normal_equations", "local_fit", "evaluate_network"} <= set(
        work
    )
    assert all(one.operations > 0 < one.bytes for one in work.values())
    assert sum(one.seconds for one in work.values()) < 2 * frame_s
    rows = roofline.format_table(work, frame_s, 1e10, 1e11)
    assert len(rows) == 2 + len(work) + 2
    assert sum("memory" in row or "arithmetic" in row for row in rows) == len(work)
