"""Recipe of the refinement of uncertain pixels: the refinement network and the rounds of message passing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from beltscape.core.progress import Reporter
from beltscape.core.statistics import MAD_TO_SIGMA
from beltscape.learned.network import Network
from beltscape.stereo.multiview.estimate import OFFSETS
from training.cache import SampleCache
from training.confidence import ACCEPTED, GROSS_MM, MOST_MM, ROUND
from training.losses import huber
from training.perceptron import (
    compute_limits,
    export_layers,
    make_layers,
    make_optimiser,
    unscale_first_layer,
)
from training.samples.refinement import Tile, join_tiles, read_tiles, write_tiles

UNITS = 96, 48
"""Hidden units of the refinement network."""
MESSAGE, OWN = 16, 32
"""Length of a state: of the message to the neighbours, and of the rest."""
ROUNDS, ROUND_UNITS = 3, 48
"""Number of rounds, and the hidden units of each."""
EPOCHS, BATCH, RATE, DECAY = 6, 36_000, 3e-3, 1e-4
FLAGS = torch.eye(2)
"""Last two numbers of the messages of rejected and of accepted pixels, whose other numbers are 0."""
HIDDEN = 6.0
"""Weight of a pixel that no auxiliary sees, and of a wrong one that the projector does not light: they are few, and
a depth there is invented."""
SHIFT_WEIGHT, SIGMA_WEIGHT = 3.0, 0.2
"""Weights of the losses of shift and sigma relative to that of the confidence."""
NEAREST_PX, FARTHEST_PX = 0.05, 1.0
"""Rounding of the corner of the shift's deviation, and the error from which on a pixel is not shifted, at scale 1."""


class RefinementNetwork(nn.Module):
    """The refinement network and the rounds of message passing."""

    def __init__(self, features: Tensor) -> None:
        super().__init__()
        limits = compute_limits(features.numpy())
        self.limits = torch.from_numpy(limits)
        within = features.clamp(*self.limits)
        self.mean, self.spread = within.mean(0), within.std(0) + 1e-6
        state, inputs = MESSAGE + OWN, len(OFFSETS) * (MESSAGE + len(FLAGS)) + OWN
        self.state_layers = make_layers(features.shape[1], *UNITS, state)
        self.rounds = nn.ModuleList(make_layers(inputs, ROUND_UNITS, k) for k in (*[state] * (ROUNDS - 1), 3))

    def forward(self, features: Tensor, neighbours: Tensor) -> Tensor:
        """Return (N, 3) logit, log sigma and shift for features (N, n) and neighbours' addresses (9, N)."""
        state = self.state_layers((features.clamp(*self.limits) - self.mean) / self.spread)
        for i, layers in enumerate(self.rounds):
            others = torch.cat([torch.zeros(len(FLAGS), MESSAGE), FLAGS], 1)
            own = functional.pad(state[:, :MESSAGE], (0, len(FLAGS)))
            messages = torch.cat([others, own])
            received = messages[neighbours.T].transpose(1, 2).flatten(1)
            change = layers(torch.cat([received, state[:, MESSAGE:]], 1))
            state = change if i == ROUNDS - 1 else state + change
        return state


def compute_loss(prediction: Tensor, tile: Tile) -> Tensor:
    """Return the weighted mean loss of confidence, sigma and shift."""
    error, mm_per_px, weight, occluded, dark = map(torch.from_numpy, tile[2:])
    logit, log_sigma, shift = prediction.T
    left = error + shift
    with torch.no_grad():
        seen = error.isfinite() & ~occluded
        right = seen & (left.abs() * mm_per_px <= GROSS_MM)
        near = seen & (left.abs() * mm_per_px <= MOST_MM)
        log_size = torch.log(MAD_TO_SIGMA * torch.where(near, left.abs(), 1.0).clamp(min=1e-4))
        measured = near & (torch.sigmoid(logit) > ACCEPTED)
        movable = seen & (left.abs() < FARTHEST_PX)
    zero = torch.zeros(())
    confidence = functional.binary_cross_entropy_with_logits(logit, right.float(), reduction="none")
    sigma = torch.where(measured, huber(log_sigma - log_size, ROUND), zero)
    moves = torch.where(movable, huber(torch.where(movable, left, zero), NEAREST_PX), zero)
    each = (
        torch.where(occluded | (dark & ~right), HIDDEN, 1.0) * confidence
        + SIGMA_WEIGHT * sigma
        + SHIFT_WEIGHT * moves
    )
    return (weight * each).sum() / weight.sum()


def draw_batches(tiles: list[Tile], rng: np.random.Generator) -> list[list[Tile]]:
    """Return the tiles in random order, several to a batch; an incomplete last one is left out, unless it is all."""
    complete: list[list[Tile]] = []
    some: list[Tile] = []
    for i in rng.permutation(len(tiles)):
        some.append(tiles[i])
        if sum(len(tile.off_px) for tile in some) >= BATCH:
            complete.append(some)
            some = []
    return complete or [some]


def fit_networks(tiles: list[Tile], reporter: Reporter) -> RefinementNetwork:
    """Return the networks of least loss."""
    torch.manual_seed(0)
    rng = np.random.default_rng(0)
    some = np.concatenate([tile.features[::20] for tile in tiles])
    model = RefinementNetwork(torch.from_numpy(some).float())
    adam = make_optimiser(model, RATE, DECAY)
    pixels = sum(len(tile.off_px) for tile in tiles)
    rate = torch.optim.lr_scheduler.OneCycleLR(
        adam, RATE, total_steps=EPOCHS * (pixels // BATCH + 1), pct_start=0.1
    )
    for epoch in range(EPOCHS):
        for drawn in draw_batches(tiles, rng):
            batch = join_tiles(drawn)
            features, neighbours = (
                torch.from_numpy(batch.features).float(),
                torch.from_numpy(batch.neighbours),
            )
            adam.zero_grad()
            compute_loss(model(features, neighbours), batch).backward()
            adam.step()
            rate.step()
        reporter.step("fit of the refinement", epoch + 1, EPOCHS)
    return model


def train_refinement(captures: list[Path], cache: SampleCache) -> dict[str, Network]:
    """Train on tiles of the captures, which are kept in the cache; return the networks by name."""
    names: tuple[str, ...] = ()
    tiles: list[Tile] = []
    folder = cache.folder / "refinement"
    cache.draw_missing("samples for the refinement", folder, captures, write_tiles)
    for capture in captures:
        found, more = read_tiles(folder / f"{capture.name}.npz")
        names, tiles = found or names, [*tiles, *more]
    return export_networks(names, fit_networks(tiles, cache.reporter))


def export_networks(names: tuple[str, ...], model: RefinementNetwork) -> dict[str, Network]:
    """Return the fitted networks by name, in the units of their features."""
    state = (*(f"message {i}" for i in range(MESSAGE)), *(f"state {i}" for i in range(OWN)))
    messages = (*state[:MESSAGE], "rejected", "accepted")
    received = (*(f"{name} at {du:+d}{dv:+d}" for name in messages for du, dv in OFFSETS), *state[MESSAGE:])
    first, *others = export_layers(model.state_layers)
    mean, spread = (part.numpy().astype(float) for part in (model.mean, model.spread))
    layers = [unscale_first_layer(first, mean, spread), *others]
    networks = {"refinement": Network(names, state, model.limits.numpy(), _as_single(layers))}
    most = np.finfo(np.float32).max
    unlimited = np.array([[-most], [most]], np.float32).repeat(len(received), 1)
    for i, layers_of_round in enumerate(model.rounds):
        outputs = ("logit", "log sigma", "shift") if i == ROUNDS - 1 else state
        weights = _as_single(export_layers(layers_of_round))
        networks[f"message_round_{i + 1}"] = Network(received, outputs, unlimited, weights)
    return networks


def _as_single(layers: list[np.ndarray]) -> tuple[np.ndarray, ...]:
    return tuple(layer.astype(np.float32) for layer in layers)
