"""The CUDA back end on a GPU, where there is one: `benchmarks/gpu.sh` runs these tests."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from beltscape.kernels import load, self_test
from beltscape.kernels.cuda.cuda_device import is_driver_present, is_library_present
from tests.kernels.rounding import ROUNDED, first_alike
from tests.kernels.sweep.test_aggregate import JUMPS, PLANES, costs
from tests.kernels.sweep.test_sweep import scene
from tests.kernels.test_resident import assert_agrees, reconstruct, same_bytes, tiny  # noqa: F401

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(
        not (is_driver_present() and is_library_present()), reason="no driver of a GPU, or no cuda-core"
    ),
]


@pytest.mark.parametrize("case", [name for name in self_test.CASES if name not in ROUNDED])
def test_self_test_gives_the_bytes_of_the_processor_twice(case):
    run = self_test.CASES[case]
    expected = [np.asarray(array).tobytes() for array in run(load(first_alike("emulated")))]
    for _ in range(2):
        assert [np.asarray(array).tobytes() for array in run(load("cuda"))] == expected


def test_the_self_test_agrees_with_the_processor():
    assert self_test.find_disagreement(load("cuda"), load("native")) is None


@pytest.mark.parametrize("planes", PLANES)
@pytest.mark.parametrize("jumps", JUMPS)
def test_aggregation_is_that_of_the_processor(planes, jumps):
    cost = costs(planes, 40, 50, planes)
    found, expected = (load(name).aggregate(cost, *jumps) for name in ("cuda", "native"))
    assert [array.tobytes() for array in found] == [array.tobytes() for array in expected]


@pytest.mark.parametrize("seed", range(5))
def test_a_sweep_is_that_of_the_processor(seed):
    given = (*scene(seed, 70 + seed, 90 - seed, 1 + seed), 0.0, 0.3, 33, 9.0)
    found, expected = (load(name).sweep(*given) for name in ("cuda", first_alike("emulated")))
    assert found.tobytes() == expected.tobytes()


@pytest.mark.parametrize("preset", ["fast", "standard"])
def test_frames_in_flight_are_each_the_same_and_agree_with_the_processor(tiny, preset):  # noqa: F811
    expected, kernels = reconstruct(tiny, load(first_alike("emulated")), preset), load("cuda")
    alone = reconstruct(tiny, kernels, preset)
    assert_agrees(alone, expected)
    with ThreadPoolExecutor(3) as pool:
        for found in pool.map(lambda _: reconstruct(tiny, kernels, preset), range(6)):
            assert same_bytes(found, alone)
    assert kernels.failure is None
