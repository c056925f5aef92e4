"""Filling of holes: each level gives the reference's heights and features but for rounding."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.errors import KernelError
from beltscape.kernels import load
from beltscape.kernels.holes import HOLE_FEATURES, FilledField
from beltscape.kernels.native import levels
from beltscape.kernels.reference import holes
from beltscape.learned.registry import load_network
from tests.strategies import seeds
from tests.thorough import examples

every_level = pytest.mark.parametrize("level", levels())
lengths = st.sampled_from([1, 3, 8, 17, 41, 90])
CELL = 1.3


def rough_field(seed: int, height: int, width: int, holes: float) -> NDArray[np.float64]:
    """(height, width) bodies on a slope with noise, steps in whole numbers, and holes of every size."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width].astype(float)
    field = rng.normal() * 0.1 * x + rng.normal() * 0.1 * y + 20 + 0.05 * rng.standard_normal(x.shape)
    for row, column, radius in rng.uniform([0, 0, 3], [height, width, 20], (8, 3)):
        field = np.maximum(
            field, 15 + np.sqrt(np.clip(radius**2 - (y - row) ** 2 - (x - column) ** 2, 0, None))
        )
    if rng.random() < 0.3:
        field = np.round(field / 4) * 4  # rims of equal heights
    gone = ndimage.gaussian_filter(rng.standard_normal(x.shape), rng.uniform(0, 4))
    gone = gone <= np.quantile(gone, holes)
    gone.ravel()[rng.integers(gone.size)] = False
    return np.where(gone, np.nan, field)


def inputs_of(seed: int, field: NDArray[np.float64]) -> tuple[NDArray[np.bool_], NDArray[np.float64], float]:
    """Pinholes, slopes of the rays and the cell."""
    rng = np.random.default_rng(seed)
    slopes = rng.uniform(-0.5, 0.5, (2, *field.shape)) * rng.integers(0, 2)
    return rng.random(field.shape) < 0.2, slopes, CELL


def fill(name: str, seed: int, field: NDArray[np.float64], rows: slice, threads: int = 1) -> FilledField:
    """Fill with Beltscape's own network."""
    network = load_network("holes")
    sigma = np.where(np.isfinite(field), np.random.default_rng(seed).uniform(0.05, 0.3, field.shape), np.nan)
    weights = network.features, network.limits, network.layers
    return load(name).fill_holes((field, sigma), *inputs_of(seed, field), weights, rows=rows, threads=threads)


@every_level
@examples(60)
@given(
    seeds, lengths, lengths, st.sampled_from([0.02, 0.2, 0.6, 0.95]), st.integers(0, 60), st.integers(0, 90)
)
def test_native_is_the_reference(
    level: str, seed: int, height: int, width: int, share: float, first: int, end: int
):
    field, rows = rough_field(seed, height, width, share), slice(first, max(first, end))
    found, expected = fill(level, seed, field, rows, 2), fill("reference", seed, field, rows)
    np.testing.assert_allclose(found.value, expected.value, rtol=0, atol=5e-4)
    np.testing.assert_allclose(found.sigma, expected.sigma, rtol=0, atol=5e-4)
    given = field, *inputs_of(seed, field)
    one, other = (load(name).hole_inputs(*given, rows=rows) for name in (level, "reference"))
    np.testing.assert_allclose(one.base, other.base, atol=1e-6)
    np.testing.assert_allclose(one.scale, other.scale, atol=1e-6)
    between = np.isfinite(other.base)
    np.testing.assert_allclose(one.features[:, between], other.features[:, between], atol=5e-4)


def test_the_features_have_their_names() -> None:
    field = rough_field(1, 30, 40, 0.2)
    shared = holes._SharedField.of(holes.HoleField(field, *inputs_of(1, field), 0, 30))
    assert tuple(shared.compute_inputs(np.nonzero(np.isnan(field))).features) == HOLE_FEATURES


@every_level
def test_any_number_of_threads_gives_the_same_bytes(level: str) -> None:
    field = rough_field(3, 300, 90, 0.3)
    runs = [fill(level, 3, field, slice(5, 290), threads) for threads in (1, 2, 5)]
    features = [
        load(level).hole_inputs(field, *inputs_of(3, field), threads=threads) for threads in (1, 2, 5)
    ]
    for run, of in zip(runs[1:], features[1:], strict=True):
        assert [part.tobytes() for part in run] == [part.tobytes() for part in runs[0]]
        assert [part.tobytes() for part in of] == [part.tobytes() for part in features[0]]


@every_level
def test_a_wide_field_is_filled_as_its_parts_are(level: str) -> None:
    field = rough_field(4, 40, 1700, 0.2)
    found, expected = (fill(name, 4, field, slice(None)) for name in (level, "reference"))
    np.testing.assert_allclose(found.value, expected.value, atol=5e-4)


@pytest.mark.parametrize("name", ["reference", *levels()])
def test_outside_all_rims_the_first_of_the_nearest_cells_is_taken(name: str) -> None:
    field = np.full((5, 7), np.nan)
    field[2, 0], field[0, 2] = 1.0, 9.0
    filled = fill(name, 0, field, slice(2, 3)).value
    # the cell in the third column is two cells from either
    assert filled[2].tolist() == [1.0, 1.0, 1.0, 9.0, 9.0, 9.0, 9.0]
    assert np.isnan(filled[[1, 3, 4]]).all()


FITS: dict[str, Any] = {
    "planes": (np.ones((5, 6)), np.ones((5, 6))), "pinhole": np.zeros((5, 6), bool),
    "ray_slope": np.zeros((2, 5, 6)), "cell": 1.0, "network": (["smooth"], np.zeros((2, 1)), [np.zeros((2, 2))]),
}  # fmt: skip


@pytest.mark.parametrize("name", ["reference", *levels()])
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"planes": (np.ones(5), np.ones(5))}, "field must have the shape (Ny, Nx), not (5,)"),
        ({"planes": (np.full((5, 6), np.nan), np.ones((5, 6)))}, "field must have a measured cell"),
        ({"planes": (np.ones((5, 6)), np.ones((5, 5)))}, "sigma must have the shape (5, 6), not (5, 5)"),
        ({"pinhole": np.zeros((5, 5), bool)}, "pinhole must have the shape (5, 6), not (5, 5)"),
        ({"ray_slope": np.zeros((5, 6))}, "ray_slope must have the shape (2, 5, 6), not (5, 6)"),
        ({"cell": 0.0}, "cell must be positive, not 0"),
        ({"rows": slice(0, 5, 2)}, "rows must be next to each other, not every 2"),
        (
            {"network": (["depth"], np.zeros((2, 1)), [np.zeros((2, 2))])},
            "the network has a feature 'depth' that hole cells do not have",
        ),
        (
            {"network": (["smooth"], np.zeros((2, 1)), [np.zeros((3, 2))])},
            "the network must have 2 outputs, not 3",
        ),
    ],
)
def test_arguments_that_do_not_fit_are_named(name: str, wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(KernelError) as error:
        load(name).fill_holes(**(FITS | wrong))
    assert str(error.value) == message
