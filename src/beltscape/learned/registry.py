"""Every fitted network by its name: what it predicts, from what, and what it must not be used for."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

from beltscape.core.errors import InputError
from beltscape.learned.network import Network, read_network


@dataclass(frozen=True, slots=True)
class Purpose:
    """The purpose of a network."""

    predicts: str
    used_by: str
    """Module that evaluates it."""
    unsuitable: str
    """What it must not be used for."""


_MATCHER = (
    "surfaces that another matcher found, or the same matcher with other windows: its features describe this one's "
    "fits; images whose pattern is coarser than a grid pixel's window or was not projected"
)

PURPOSES = {
    "initial_confidence": Purpose(
        "the logit of the probability that a pixel's surface is right, before the candidate selection",
        "beltscape.stereo.multiview.features",
        _MATCHER,
    ),
    "candidates": Purpose(
        "the logit of the probability that a candidate surface is right",
        "beltscape.stereo.multiview.candidates",
        _MATCHER,
    ),
    "confidence": Purpose(
        "the logit of the confidence and the logarithm of sigma in px of inverse depth, preset standard",
        "beltscape.stereo.multiview.estimate",
        _MATCHER,
    ),
    "fast_confidence": Purpose(
        "the logit of the confidence and the logarithm of sigma in px of inverse depth, preset fast",
        "beltscape.stereo.multiview.estimate",
        _MATCHER,
    ),
    "refinement": Purpose(
        "the state of an uncertain pixel, from which messages between pixels start",
        "beltscape.stereo.multiview.estimate",
        _MATCHER,
    ),
    **{
        f"message_round_{i}": Purpose(
            f"{what} an uncertain pixel, from its own state and the messages of the nine pixels around",
            "beltscape.stereo.multiview.estimate",
            _MATCHER,
        )
        for i, what in (
            (1, "the change of the state of"),
            (2, "the change of the state of"),
            (3, "logit of the confidence, logarithm of sigma and shift of"),
        )
    },
    "holes": Purpose(
        "mean and log variance of the height of an unmeasured cell, in units of the range of its rims",
        "beltscape.measure.holes",
        "bodies that are not bulk material or plane-faced solids on a belt, such as sheets or pipes",
    ),
    "lumps": Purpose(
        "the logits of the probabilities that a cell lies on a lump's outline, and on a lump",
        "beltscape.measure.lumps.segment",
        "material that is finer than about four cells, or lumps that are flakes",
    ),
}
"""By name; the file is data/networks/NAME.npz."""


_folder: Traversable = files("beltscape") / "data" / "networks"


def use_networks(folder: Path) -> None:
    """Load all networks from another folder from now on, as a training does with those it has fitted so far."""
    global _folder  # noqa: PLW0603
    _folder = folder
    load_network.cache_clear()
    hash_networks.cache_clear()


@cache
def load_network(name: str) -> Network:
    """Return the network of a name.

    Raises
    ------
    InputError
        If there is none of this name, or its file is missing or damaged.
    """
    if name not in PURPOSES:
        raise InputError(f"no network is called {name}; there are {', '.join(PURPOSES)}")
    source = _folder / f"{name}.npz"
    if not source.is_file():
        raise InputError(f"{source}: is missing; `make train` fits it")
    with source.open("rb") as stream:
        return read_network(stream, source.name)


@cache
def hash_networks() -> str:
    """Return the SHA-256 of all fitted networks that the program uses, over the names and bytes of their files."""
    total = sha256()
    for name in sorted(PURPOSES):
        source = _folder / f"{name}.npz"
        total.update(name.encode())
        total.update(source.read_bytes() if source.is_file() else b"")
    return total.hexdigest()
