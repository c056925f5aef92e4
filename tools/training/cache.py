"""Samples of captures, kept on disk, so that a training that was stopped goes on where it was."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from beltscape.core.progress import Reporter
from training.drawing import Drawing

Arrays = dict[str, np.ndarray]
_SHARED = "names"
"""End of the names of arrays that all captures have in common; all others are joined."""


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
    drawing: Drawing = field(default_factory=Drawing)

    def collect(self, network: str, captures: list[Path], draw: Callable[[Path, int], Arrays]) -> Arrays:
        """Return the samples of all captures for a network; ``draw(capture, turn)`` draws those not kept yet."""
        folder = self.folder / network
        self.draw_missing(f"samples for {network}", folder, captures, partial(_write_samples, draw))
        files = [folder / f"{capture.name}.npz" for capture in captures]
        joined = join_files(files)
        if not joined:
            raise ValueError(f"no capture has samples for {network}")
        return joined

    def draw_missing(
        self, stage: str, folder: Path, captures: list[Path], write: Callable[[Path, Path, int], object]
    ) -> None:
        """Call ``write(path, capture, turn)`` for every capture without a file in a folder."""
        folder.mkdir(parents=True, exist_ok=True)
        paths = [folder / f"{capture.name}.npz" for capture in captures]
        tasks = [
            (path, capture, turn)
            for turn, (path, capture) in enumerate(zip(paths, captures, strict=True))
            if not path.is_file()
        ]
        kept = len(captures) - len(tasks)
        self.drawing.run(write, tasks, lambda done: self.reporter.step(stage, kept + done, len(captures)))


def join_files(paths: list[Path]) -> Arrays:
    """Return the arrays of files, each joined over all files; files without arrays are left out."""
    files = [path for path in paths if _list_arrays(path)]
    return {
        name: _join_arrays(files, name) if not name.endswith(_SHARED) else _read_array(files[0], name)
        for name in (_list_arrays(files[0]) if files else ())
    }


def _join_arrays(paths: list[Path], name: str) -> np.ndarray:
    """Return an array of all files, joined along its first axis, with little more memory than that takes."""
    first, rows = _read_array(paths[0], name), [len(_read_array(path, name)) for path in paths]
    joined = np.empty((sum(rows), *first.shape[1:]), first.dtype)
    ends = np.cumsum(rows)
    for path, count, end in zip(paths, rows, ends, strict=True):
        joined[end - count : end] = _read_array(path, name)
    return joined


def _list_arrays(path: Path) -> list[str]:
    with np.load(path, allow_pickle=False) as arrays:
        return list(arrays.files)


def _read_array(path: Path, name: str) -> np.ndarray:
    with np.load(path, allow_pickle=False) as arrays:
        return arrays[name]


def _write_samples(draw: Callable[[Path, int], Arrays], path: Path, capture: Path, turn: int) -> None:
    write_whole(path, draw(capture, turn))
