"""Train the refinement of uncertain pixels: the refinement network and the rounds of message passing.

    python tools/refinement_samples.py TILES CAPTURE…
    python tools/train_refinement.py TILES [FOLDER]

It writes refinement.json and message_passing.json to FOLDER, without it to data/, from where the program reads them.
They depend on the networks of train_confidence.py. Only
this tool needs PyTorch (``pip install torch``). Assess the result on captures that are not among them.
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

from beltscape.core.statistics import MAD_TO_SIGMA
from beltscape.stereo.multiview.confidence.message_passing import OFFSETS
from refinement_samples import Tile, join_tiles, read_tiles
from train_confidence import (
    ACCEPTED,
    DATA,
    GROSS_MM,
    MOST_MM,
    ROUND,
    TrainedNetwork,
    compute_limits,
    format_rows,
    write_network,
)

UNITS = 96, 48
"""Hidden units of the refinement network."""
MESSAGE, OWN = 16, 32
"""Length of a state: of the message to the neighbours, and of the rest."""
ROUNDS, ROUND_UNITS = 3, 48
"""Number of rounds, and the hidden units of each."""
EPOCHS, BATCH, RATE, DECAY = 20, 36_000, 3e-3, 1e-4
OCCLUDED = 6.0
"""Weight of a pixel that no auxiliary sees: they are few, and right there only by chance."""
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
        state, inputs = MESSAGE + OWN, len(OFFSETS) * MESSAGE + OWN
        self.state_layers = make_layers(features.shape[1], *UNITS, state)
        self.rounds = nn.ModuleList(make_layers(inputs, ROUND_UNITS, k) for k in (*[state] * (ROUNDS - 1), 3))
        self.fixed_messages = nn.ParameterList(torch.zeros(2, MESSAGE) for _ in self.rounds)

    def forward(self, features: Tensor, neighbours: Tensor) -> Tensor:
        """Return (N, 3) logit, log sigma and shift for features (N, n) and neighbours' addresses (9, N)."""
        state = self.state_layers((features.clamp(*self.limits) - self.mean) / self.spread)
        for i, (fixed, layers) in enumerate(zip(self.fixed_messages, self.rounds, strict=True)):
            messages = torch.cat([fixed, state[:, :MESSAGE]])
            received = messages[neighbours.T].transpose(1, 2).flatten(1)
            change = layers(torch.cat([received, state[:, MESSAGE:]], 1))
            state = change if i == ROUNDS - 1 else state + change
        return state


def make_layers(*sizes: int) -> nn.Sequential:
    """Return linear layers, all but the last rectified."""
    layers = [part for a, b in pairwise(sizes) for part in (nn.Linear(a, b), nn.ReLU())]
    return nn.Sequential(*layers[:-1])


def compute_loss(prediction: Tensor, tile: Tile) -> Tensor:
    """Return the weighted mean loss of confidence, sigma and shift."""
    error, mm_per_px, weight, occluded = map(torch.from_numpy, tile[2:])
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
    each = torch.where(occluded, OCCLUDED, 1.0) * confidence + SIGMA_WEIGHT * sigma + SHIFT_WEIGHT * moves
    return (weight * each).sum() / weight.sum()


def huber(deviation: Tensor, corner: float) -> Tensor:
    """Return the absolute deviation with its corner rounded by a parabola."""
    return (
        functional.huber_loss(deviation, torch.zeros_like(deviation), reduction="none", delta=corner) / corner
    )


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


def fit_networks(tiles: list[Tile]) -> RefinementNetwork:
    """Return the networks of least loss."""
    torch.manual_seed(0)
    rng = np.random.default_rng(0)
    model = RefinementNetwork(
        torch.from_numpy(np.concatenate([tile.features[::20] for tile in tiles])).float()
    )
    adam = torch.optim.AdamW(model.parameters(), lr=RATE, weight_decay=DECAY)
    pixels = sum(len(tile.off_px) for tile in tiles)
    rate = torch.optim.lr_scheduler.OneCycleLR(
        adam, RATE, total_steps=EPOCHS * (pixels // BATCH + 1), pct_start=0.1
    )
    began = time.monotonic()
    for epoch in range(EPOCHS):
        losses = []
        for some in draw_batches(tiles, rng):
            batch = join_tiles(some)
            loss = compute_loss(
                model(torch.from_numpy(batch.features).float(), torch.from_numpy(batch.neighbours)), batch
            )
            adam.zero_grad()
            loss.backward()
            adam.step()
            rate.step()
            losses.append(float(loss.detach()))
        print(f"{epoch + 1} of {EPOCHS}: {np.mean(losses):.4f}, {time.monotonic() - began:.0f} s", flush=True)
    return model


def export_layers(layers: nn.Sequential) -> list[np.ndarray]:
    """Return the (outputs, inputs + 1) weights and offsets of each layer, as in the files."""
    linear = [layer for layer in layers if isinstance(layer, nn.Linear)]
    return [
        torch.cat([layer.weight, layer.bias[:, None]], 1).detach().numpy().astype(float) for layer in linear
    ]


def main() -> None:
    """Read the tiles, train and write."""
    names: tuple[str, ...] = ()
    tiles: list[Tile] = []
    for path in sorted(Path(sys.argv[1]).glob("*.npz")):
        names, found = read_tiles(path)
        tiles += found
    print(len(tiles), "tiles,", sum(len(tile.off_px) for tile in tiles), "pixels", flush=True)
    model = fit_networks(tiles)
    first, *others = export_layers(model.state_layers)
    mean, spread = (part.numpy().astype(float) for part in (model.mean, model.spread))
    own = np.hstack([first[:, :-1] / spread, first[:, -1:] - first[:, :-1] @ (mean / spread)[:, None]])
    folder = Path(sys.argv[2]) if len(sys.argv) > 2 else DATA
    write_network(TrainedNetwork("refinement", names, model.limits.numpy(), [own, *others]), folder)
    write_rounds(model, folder)


def write_rounds(model: RefinementNetwork, folder: Path) -> None:
    """Write message_passing.json."""
    rounds = [
        f'{{"fixed_messages": {format_rows(fixed.detach().numpy())},\n'
        f'"layers": [{", ".join(map(format_rows, export_layers(layers)))}]}}'
        for fixed, layers in zip(model.fixed_messages, model.rounds, strict=True)
    ]
    text = '{"rounds": [\n' + ",\n".join(rounds) + "\n]}\n"
    (folder / "message_passing.json").write_text(text, "utf-8")


if __name__ == "__main__":
    main()
