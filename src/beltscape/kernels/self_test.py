"""The self-test of a GPU: its kernels against those of the processor, on a small scene with every kind of pixel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

TOLERANCE = 1e-3
"""Of a value, relative to values above 1: ten times what single precision leaves after a pixel's sums."""
MOST_DIFFERENT = 1e-3
"""Share of values that may differ more: a sample at the very border may be in for one and out for the other."""

_HEIGHT, _WIDTH, _VIEWS = 70, 90, 3
"""Size of the test images: more than one block of threads in each direction; and number of views."""


def find_disagreement(found: Any, expected: Any) -> str | None:
    """Return the first kernel whose results differ from the expected ones and by how much; None if all agree.

    Parameters
    ----------
    found, expected
        `beltscape.kernels.Kernels` of two back ends.
    """
    for name, run in CASES.items():
        share = compare_results(run(found), run(expected))
        if share > MOST_DIFFERENT:
            return f"{name} differs from the processor's in {share:.2%} of the values"
    return None


def compare_results(found: Sequence[NDArray[Any]], expected: Sequence[NDArray[Any]]) -> float:
    """Return the largest share of differing values among the results of a case."""
    return max(_share_of_differences(a, b) for a, b in zip(found, expected, strict=True))


def _share_of_differences(found: NDArray[Any], expected: NDArray[Any]) -> float:
    a, b = np.asarray(found, float), np.asarray(expected, float)
    with np.errstate(invalid="ignore"):  # infinite less infinite
        close = abs(a - b) <= TOLERANCE * np.maximum(1, abs(b))
    return 1 - float(np.mean(close | (a == b) | (np.isnan(a) & np.isnan(b))))


def _random(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def _texture(seed: int) -> NDArray[np.float32]:
    """Return (_HEIGHT, _WIDTH) grey levels, neighbours alike."""
    noise = _random(seed).normal(size=(_HEIGHT + 4, _WIDTH + 4))
    smooth = sum(noise[i : i + _HEIGHT, j : j + _WIDTH] for i in range(5) for j in range(5))
    return np.clip(128 + 8 * smooth, 0, 255).astype(np.float32)


def _views() -> NDArray[np.float32]:
    """Return (_VIEWS, 39) projections of cameras beside the core, with a lens of Brown's model."""
    focal, center = 80.0, np.array([_WIDTH / 2, _HEIGHT / 2])
    inverse = np.array([[1 / focal, 0, -center[0] / focal], [0, 1 / focal, -center[1] / focal], [0, 0, 1]])
    lens = [0.05, -0.01, 1e-3, -5e-4, 0.002, 4.0, 0.0, *np.zeros(7), *np.eye(3).ravel()]
    rows = [
        [*inverse.ravel(), dx / focal, dy / focal, 0.1 / focal, focal, focal, *center, *lens]
        for dx, dy in ((1, 0.1), (-1, 0.2), (0.2, 1))
    ]
    return np.array(rows, np.float32)


def _surface() -> NDArray[np.float32]:
    """Return (_HEIGHT, _WIDTH) inverse depth with a step, noise and missing pixels."""
    s = 3 + 2 * (np.arange(_WIDTH) > _WIDTH // 2) + _random(5).normal(0, 0.2, (_HEIGHT, _WIDTH))
    s[_random(6).random(s.shape) < 0.05] = np.nan
    return s.astype(np.float32)


def _images() -> list[NDArray[np.float32]]:
    return [_texture(i) for i in range(1, _VIEWS + 1)]


def _sweep(kernels: Any) -> Sequence[NDArray[Any]]:
    return kernels.sweep_and_aggregate(_texture(0), _images(), _views(), 0.0, 0.3, 20, 9.0, 8, 80)


def _normal_equations(kernels: Any) -> Sequence[NDArray[Any]]:
    core = _texture(0)
    core[30:33, 40:44] = np.nan
    coefficients = [kernels.spline_coefficients(image) for image in _images()]
    equations = kernels.normal_equations(
        _surface(), core, coefficients, _views(), floor=9.0, noise_variance=4.0, model_variance=1e-3
    )
    return [np.asarray(part) for part in equations]


def _local_fit(kernels: Any) -> Sequence[NDArray[Any]]:
    s, zero = _surface(), np.zeros((_HEIGHT, _WIDTH), np.float32)
    information, pull = _texture(7), _texture(8) - 128
    return [np.asarray(part) for part in kernels.local_fit(information, pull, s, zero, zero, tolerance=1.0)]


def _layers() -> list[NDArray[np.float32]]:
    shapes = (12, 10), (3, 13)
    return [_random(i).normal(0, 0.3, shape).astype(np.float32) for i, shape in enumerate(shapes)]


def _limits() -> NDArray[np.float64]:
    return np.stack([np.full(9, 0.2), np.full(9, 2.4)])


def _network(kernels: Any) -> Sequence[NDArray[Any]]:
    planes = [_texture(i) / 100 for i in range(9)]
    return kernels.evaluate_network(planes, _limits(), _layers())


def _buffers(kernels: Any) -> list[NDArray[np.float32]]:
    return list(kernels.inverse_depth_buffers(_surface(), _views(), [(_WIDTH, _HEIGHT)] * _VIEWS))


def _visibility(kernels: Any) -> Sequence[NDArray[Any]]:
    buffers = _buffers(kernels)
    masks = [kernels.visible(_surface(), *seen, 0.5) for seen in zip(_views(), buffers, strict=True)]
    return [*buffers, *masks]


def _propagate(kernels: Any) -> Sequence[NDArray[Any]]:
    s, zero = _surface(), np.zeros((_HEIGHT, _WIDTH), np.float32)
    offsets = np.array([(2, 0), (-2, 0), (0, 3), (4, -4)])
    return kernels.propagate(
        s, zero, zero, _texture(0), _images(), _views(), _buffers(kernels), offsets=offsets, floor=9.0
    )


def _candidates(kernels: Any) -> Sequence[NDArray[Any]]:
    s, zero, one = _surface(), np.zeros((_HEIGHT, _WIDTH), np.float32), np.ones((_HEIGHT, _WIDTH), np.float32)
    pixels = np.arange(_WIDTH), np.arange(_WIDTH) % _HEIGHT
    reliable = _random(9).random(s.shape) < 0.5
    candidates = kernels.candidate_surfaces(s, zero, zero, reliable, *pixels, reach=5, separation=1.0)
    consistency = kernels.photo_consistency(
        *pixels, *candidates[:3], core=_texture(0), variance=400 * one, images=_images(), views=_views(),
        buffers=_buffers(kernels), gains=[one] * _VIEWS, tolerance=1.0,
    )  # fmt: skip
    gathered = kernels.gather([s, _texture(1)], *pixels, np.array([(0, 0), (-3, 2)]))
    return [*candidates, *consistency, gathered]


def _messages(kernels: Any) -> Sequence[NDArray[Any]]:
    senders = _random(1).integers(0, 50, (3, 80)).astype(np.int32)
    messages, state = _random(2).normal(size=(4, 50)), _random(3).normal(size=(2, 80))
    layers = _random(4).normal(0, 0.3, (8, 15)), _random(5).normal(0, 0.3, (2, 9))
    return [kernels.pass_messages(messages, senders, state, layers)]


def _windows(kernels: Any) -> Sequence[NDArray[Any]]:
    plane, mask = _texture(3), _random(7).random((_HEIGHT, _WIDTH)) < 0.02
    pixels = kernels.list_pixels(mask)
    return [
        kernels.average_windows(plane, (9, 15)),
        *kernels.measure_moments(plane, (9, 15)),
        kernels.find_extremes(plane, (5, 11), largest=True),
        kernels.median_of_windows(plane),
        kernels.measure_distances(mask),
        kernels.average_areas(plane, (_WIDTH // 4, _HEIGHT // 3)),
        kernels.put_pixels(plane, pixels, np.arange(len(pixels[0]), dtype=np.float32)),
        kernels.filter_plane(plane, _random(8).normal(0, 0.1, (3, 5))),
        kernels.find_quantile([plane, _texture(4)], 0.9),
        kernels.average_plane(plane),
        kernels.measure_phases(plane),
    ]


def _photometry(kernels: Any) -> Sequence[NDArray[Any]]:
    images = _texture(3).astype(np.uint8), (200 * _texture(4)).astype(np.uint16)
    return [
        *(kernels.measure_contrast(image) for image in images),
        *(kernels.make_levels(image, 1.25) for image in images),
        kernels.measure_sharpness(_texture(3), (1.5, 1.8, 3.4)),
    ]


def _expression(kernels: Any) -> Sequence[NDArray[Any]]:
    def compute(resident: Any) -> list[NDArray[Any]]:
        a, b = resident.keep(_texture(1)), resident.keep(_texture(2) - 100)
        roots = np.sqrt(np.abs(b)) / (1 + np.exp(-b / 20))
        return [np.asarray(each) for each in (np.log(a + np.float32(0.1)) + roots, np.hypot(a, b) > 150)]

    return kernels.run_resident(compute)


def _network_of_programs(kernels: Any) -> Sequence[NDArray[Any]]:
    def compute(resident: Any) -> list[NDArray[Any]]:
        planes = [resident.keep(_texture(i)) / 100 for i in range(9)]
        planes[3] = resident.keep(planes[3] * planes[4])
        outputs = resident.evaluate_network(planes, _limits(), _layers())
        return [np.asarray(each) for each in (*outputs, planes[3])]

    return kernels.run_resident(compute)


CASES: dict[str, Callable[[Any], Sequence[NDArray[Any]]]] = {
    "sweep_and_aggregate": _sweep,
    "normal_equations": _normal_equations,
    "local_fit": _local_fit,
    "evaluate_network": _network,
    "visible": _visibility,
    "propagate": _propagate,
    "photo_consistency": _candidates,
    "pass_messages": _messages,
    "average_windows": _windows,
    "measure_sharpness": _photometry,
    "evaluate_expression": _expression,
    "evaluate_network_of_programs": _network_of_programs,
}
"""Kernel, the last of those that it runs → their results."""
