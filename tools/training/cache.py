"""Samples of captures, kept on disk, so that a training that was stopped goes on where it was."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from beltscape.core.progress import Reporter

Arrays = dict[str, np.ndarray]
_SHARED = "names"
"""Array that all captures have in common; all others are joined."""


def write_whole(path: Path, arrays: Arrays) -> None:
    """Write arrays to a file that is there only when it is complete; uncompressed, for they are gigabytes."""
    part = path.with_suffix(".part.npz")
    np.savez(part, allow_pickle=False, **arrays)
    part.replace(path)


@dataclass(frozen=True)
class SampleCache:
    """A folder with a file of samples for each network and capture."""

    folder: Path
    reporter: Reporter

    def collect(self, network: str, captures: list[Path], draw: Callable[[Path, int], Arrays]) -> Arrays:
        """Return the samples of all captures for a network; ``draw(capture, turn)`` draws those not kept yet."""
        found: list[Arrays] = []
        for turn, capture in enumerate(captures):
            path = self.folder / network / f"{capture.name}.npz"
            if not path.is_file():
                path.parent.mkdir(parents=True, exist_ok=True)
                write_whole(path, draw(capture, turn))
            with np.load(path, allow_pickle=False) as arrays:
                found.append(dict(arrays))
            self.reporter.step(f"samples for {network}", turn + 1, len(captures))
        found = [arrays for arrays in found if arrays]
        if not found:
            raise ValueError(f"no capture has samples for {network}")
        return {
            name: found[0][name] if name == _SHARED else np.concatenate([arrays[name] for arrays in found])
            for name in found[0]
        }
