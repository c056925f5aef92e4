"""Losses of the fits."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from training.perceptron import Loss


def make_cross_entropy(right: np.ndarray, weight: np.ndarray | None = None) -> Loss:
    """Return the cross-entropy of logits (B, m) with the shares (N, m) that are right, weighted (N, m)."""
    target = torch.from_numpy(right.astype(np.float32))
    weights = torch.ones_like(target) if weight is None else torch.from_numpy(weight.astype(np.float32))
    return lambda found, at: functional.binary_cross_entropy_with_logits(found, target[at], weights[at])


def make_absolute_deviation(values: np.ndarray, weight: np.ndarray, corner: float) -> Loss:
    """Return the weighted mean absolute deviation from values (N,): outputs (B, 1) become their median."""
    target, weights = (torch.from_numpy(part.astype(np.float32)) for part in (values, weight))
    return lambda found, at: (weights[at] * huber(found[:, 0] - target[at], corner)).mean()


def make_mean_and_variance(
    values: np.ndarray, weight: np.ndarray, variance_weight: float, limits: tuple[float, float]
) -> Loss:
    """Return the squared error of means plus the likelihood of log variances, which does not move the means."""
    target, weights = (torch.from_numpy(part.astype(np.float32)) for part in (values, weight))

    def compute(found: Tensor, at: Tensor) -> Tensor:
        off = found[:, 0] - target[at]
        log_variance = found[:, 1].clamp(*limits)
        # outliers count in full: the variance of a volume is a sum of these, and outliers are a part of it
        likelihood = log_variance + off.detach() ** 2 * torch.exp(-log_variance)
        return (weights[at] * (off**2 + variance_weight * likelihood)).mean()

    return compute


def huber(deviation: Tensor, corner: float) -> Tensor:
    """Return the absolute deviation with its corner rounded by a parabola of half width ``corner``."""
    zero = torch.zeros_like(deviation)
    return functional.huber_loss(deviation, zero, reduction="none", delta=corner) / corner
