"""Fit what doubtful pixels are told: scrutiny of each, and the rounds in which they hear each other.

    python tools/doubts.py TILES CAPTURE…
    python tools/fit_scrutiny.py TILES

Written are scrutiny.json and messages.json of data/; they rest on the networks of fit_belief.py. Needs PyTorch
(``pip install torch``), which nothing else does. Judge the result on captures that are not among them.
"""

from __future__ import annotations

import sys
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from beltscape.stereo.multiview.confidence.message_passing import OFFSETS
from doubts import Tile, joined, read_tiles
from fit_belief import BELIEVED, GROSS_MM, MAD, MOST_MM, ROUND, limits_of, numbers, write, write_text

UNITS = 96, 48
"""Of scrutiny's network."""
SAID, KEPT = 16, 32
"""Numbers of a state: a message to all around, and a pixel's own."""
ROUNDS, HEARING = 3, 48
"""And the units of each."""
EPOCHS, BATCH, RATE, DECAY = 20, 36_000, 3e-3, 1e-4
UNSEEN = 6.0
"""What a pixel that no auxiliary sees counts for: they are few, and what is right there is a guess."""
MOVES, SIZES = 3.0, 0.2
"""What where a pixel belongs and its sigma count for, beside whether it is right."""
NEAREST_PX, FARTHEST_PX = 0.05, 1.0
"""About its corner the absolute deviation of what is moved is bent; who lies farther off is lost, at scale 1."""


class Conferring(nn.Module):
    """All networks of `beltscape.stereo.multiview.confidence.message_passing` and the one before."""

    def __init__(self, evidence: Tensor) -> None:
        super().__init__()
        limits = limits_of(evidence.numpy())
        self.limits = torch.from_numpy(limits)
        within = evidence.clamp(*self.limits)
        self.mean, self.spread = within.mean(0), within.std(0) + 1e-6
        state, heard = SAID + KEPT, len(OFFSETS) * SAID + KEPT
        self.look = layered(evidence.shape[1], *UNITS, state)
        self.rounds = nn.ModuleList(layered(heard, HEARING, k) for k in (*[state] * (ROUNDS - 1), 3))
        self.others = nn.ParameterList(torch.zeros(2, SAID) for _ in self.rounds)

    def forward(self, evidence: Tensor, near: Tensor) -> Tensor:
        """(N, 3) logit, log sigma and move of pixels with evidence (N, n) that hear those at addresses (9, N)."""
        state = self.look((evidence.clamp(*self.limits) - self.mean) / self.spread)
        for i, (others, hear) in enumerate(zip(self.others, self.rounds, strict=True)):
            said = torch.cat([others, state[:, :SAID]])
            messages = said[near.T].transpose(1, 2).flatten(1)
            answers = hear(torch.cat([messages, state[:, SAID:]], 1))
            state = answers if i == ROUNDS - 1 else state + answers
        return state


def layered(*sizes: int) -> nn.Sequential:
    """Linear layers, all but the last rectified."""
    layers = [part for a, b in pairwise(sizes) for part in (nn.Linear(a, b), nn.ReLU())]
    return nn.Sequential(*layers[:-1])


def loss(told: Tensor, tile: Tile) -> Tensor:
    """Of being right once moved, of sigma then, and of how far to move: a mean over weights."""
    off, mm_per_px, weight, unseen = map(torch.from_numpy, tile[2:])
    logit, log_sigma, shift = told.T
    left = off + shift
    with torch.no_grad():
        seen = off.isfinite() & ~unseen
        right = seen & (left.abs() * mm_per_px <= GROSS_MM)
        near = seen & (left.abs() * mm_per_px <= MOST_MM)
        log_size = torch.log(MAD * torch.where(near, left.abs(), 1.0).clamp(min=1e-4))
        measured = near & (torch.sigmoid(logit) > BELIEVED)
        movable = seen & (left.abs() < FARTHEST_PX)
    zero = torch.zeros(())
    judged = functional.binary_cross_entropy_with_logits(logit, right.float(), reduction="none")
    sized = torch.where(measured, bent(log_sigma - log_size, ROUND), zero)
    moved = torch.where(movable, bent(torch.where(movable, left, zero), NEAREST_PX), zero)
    each = torch.where(unseen, UNSEEN, 1.0) * judged + SIZES * sized + MOVES * moved
    return (weight * each).sum() / weight.sum()


def bent(deviation: Tensor, corner: float) -> Tensor:
    """The absolute deviation, a parabola about its corner."""
    return (
        functional.huber_loss(deviation, torch.zeros_like(deviation), reduction="none", delta=corner) / corner
    )


def batches(tiles: list[Tile], rng: np.random.Generator) -> list[list[Tile]]:
    """All tiles in random order, several at a time."""
    found: list[list[Tile]] = []
    some: list[Tile] = []
    for i in rng.permutation(len(tiles)):
        some.append(tiles[i])
        if sum(len(tile.off_px) for tile in some) >= BATCH:
            found.append(some)
            some = []
    return found


def fit(tiles: list[Tile]) -> Conferring:
    """The networks of least loss."""
    torch.manual_seed(0)
    rng = np.random.default_rng(0)
    model = Conferring(torch.from_numpy(np.concatenate([tile.evidence[::20] for tile in tiles])).float())
    adam = torch.optim.AdamW(model.parameters(), lr=RATE, weight_decay=DECAY)
    pixels = sum(len(tile.off_px) for tile in tiles)
    rate = torch.optim.lr_scheduler.OneCycleLR(
        adam, RATE, total_steps=EPOCHS * (pixels // BATCH + 1), pct_start=0.1
    )
    began = time.monotonic()
    for epoch in range(EPOCHS):
        losses = []
        for some in batches(tiles, rng):
            batch = joined(some)
            found = loss(model(torch.from_numpy(batch.evidence).float(), torch.from_numpy(batch.near)), batch)
            adam.zero_grad()
            found.backward()
            adam.step()
            rate.step()
            losses.append(float(found.detach()))
        print(f"{epoch + 1} of {EPOCHS}: {np.mean(losses):.4f}, {time.monotonic() - began:.0f} s", flush=True)
    return model


def weights(layers: nn.Sequential) -> list[np.ndarray]:
    """As the perceptron takes them."""
    linear = [layer for layer in layers if isinstance(layer, nn.Linear)]
    return [
        torch.cat([layer.weight, layer.bias[:, None]], 1).detach().numpy().astype(float) for layer in linear
    ]


def main() -> None:
    """Read, fit, write."""
    names: tuple[str, ...] = ()
    tiles: list[Tile] = []
    for path in sorted(Path(sys.argv[1]).glob("*.npz")):
        names, found = read_tiles(path)
        tiles += found
    print(len(tiles), "tiles,", sum(len(tile.off_px) for tile in tiles), "pixels", flush=True)
    model = fit(tiles)
    first, *others = weights(model.look)
    mean, spread = (part.numpy().astype(float) for part in (model.mean, model.spread))
    own = np.hstack([first[:, :-1] / spread, first[:, -1:] - first[:, :-1] @ (mean / spread)[:, None]])
    write("scrutiny", names, model.limits.numpy(), [own, *others])
    write_rounds(model)


def write_rounds(model: Conferring) -> None:
    """messages.json."""
    rounds = [
        f'{{"others": {numbers(others.detach().numpy())},\n"layers": [{", ".join(map(numbers, weights(hear)))}]}}'
        for others, hear in zip(model.others, model.rounds, strict=True)
    ]
    write_text("messages", '{"rounds": [\n' + ",\n".join(rounds) + "\n]}\n")


if __name__ == "__main__":
    main()
