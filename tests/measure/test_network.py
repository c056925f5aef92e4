"""Small networks: evaluation, and the files that are shipped."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.measure.network import Network, load_network


def test_it_does_its_sums() -> None:
    one = np.array([[1.0], [-2.0]], np.float32)
    two = np.array([[3.0, 1.0]], np.float32)
    none = np.zeros(1, np.float32)
    found = Network(
        np.array([1, 0], np.float32),
        np.array([2, 1], np.float32),
        ((one, none), (two, np.zeros(2, np.float32))),
    )
    values = np.array([[5.0, 0.0], [1.0, 7.0]], np.float32)
    np.testing.assert_allclose(found(values), [[6, 2], [0, 0]])
    mean, sigma = found.predict_mean_and_sigma(values)
    np.testing.assert_allclose(mean, [6, 0])
    np.testing.assert_allclose(sigma, np.exp([1.0, 0.0]))
    np.testing.assert_allclose(
        found.predict_probabilities(values), 1 / (1 + np.exp([[-6, -2], [0, 0]])), rtol=1e-6
    )


@pytest.mark.parametrize("name", ["holes", "edge_fattening", "lumps"])
def test_shipped_ones_come_through_their_documents(name: str) -> None:
    found = load_network(name)
    document = found.to_document()
    assert document["layers"][-1]["offsets"] == pytest.approx(found.layers[-1][1].tolist())
    assert found.layers[-1][0].shape[1] == 2
    assert found.mean.shape == found.scale.shape == (found.layers[0][0].shape[0],)
    assert (found.scale > 0).all()
