"""Train every network from nothing but the simulator's seeds; what is there already is not done again.

    cd tools && python -m training [--work FOLDER] [--captures N] [--heaps N] [--only NETWORK … [--ship]]
                                   [--workers N] [--out FOLDER]

Captures, samples and networks are kept in the work folder (default: out/train); a run that was stopped goes on where
it was. With --only some networks are fitted, from samples that the networks that ship gave; each fit says whether it
gave the network that ships, and --ship puts them in its place. When all networks are trained they are written to the
package's data with their manifest. The whole takes some hours on two cores. It needs PyTorch: pip install
'beltscape[train]'.

With --workers captures are rendered and samples drawn in N processes, a core each, which needs Ray: pip install
'beltscape[cluster]'. One process fits the networks; samples and networks are the same bytes with any number.
"""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

import beltscape
from beltscape.core.progress import Reporter
from beltscape.learned.network import Network, write_network
from beltscape.learned.registry import PURPOSES, use_networks
from beltscape.workers.options import HERE, WorkerOptions
from training.assessment import assess_networks, assess_reconstruction
from training.belts import render_heap
from training.cache import SampleCache
from training.confidence import train_candidates, train_pixels
from training.drawing import Drawing
from training.holes import train_holes
from training.instructions import restart_pinned
from training.lumps import train_lumps
from training.manifest import Assessment, replace_networks, write_manifest
from training.perceptron import set_deterministic
from training.progress import PrintedProgress
from training.refinement import train_refinement
from training.scenarios import HELD_OUT, locate_capture, render_scenario

ROOT = Path(__file__).parents[2]
DATA = Path(beltscape.__file__).parent / "data" / "networks"
CAPTURES = 72
"""Number of scenarios that the shipped networks are trained on ..."""
ASSESSED = 8
"""... and of those that they are assessed on: one of each kind in turn."""
HEAPS, HEAPS_ASSESSED = 27, 2
"""Numbers of moving heaps likewise."""


THREADS = 2
"""Threads of every fit: with another number sums are rounded otherwise."""


@dataclass(frozen=True)
class Training:
    """The folders of a training, and its captures."""

    work: Path
    captures: list[Path]
    heaps: list[Path]
    """Captures of moving heaps."""
    reporter: Reporter
    workers: WorkerOptions = HERE

    @property
    def networks(self) -> Path:
        """Return the folder of the networks trained so far."""
        return self.work / "networks"

    @property
    def samples(self) -> SampleCache:
        """Return the cache of samples."""
        return SampleCache(self.work / "samples", self.reporter, self.drawing)

    @property
    def drawing(self) -> Drawing:
        """Return where samples are drawn, with the networks in use."""
        return Drawing(self.workers, self.in_use if self.in_use.is_dir() else None)

    @property
    def in_use(self) -> Path:
        """Return the folder that `use` fills with the networks in use."""
        return self.work / "in_use"

    def is_done(self, *names: str) -> bool:
        """Return whether the networks of these names are trained."""
        return all((self.networks / f"{name}.npz").is_file() for name in names)

    def keep(self, networks: dict[str, Network]) -> None:
        """Write trained networks, and say how far they are from those that ship."""
        self.networks.mkdir(parents=True, exist_ok=True)
        for name, network in networks.items():
            write_network(self.networks / f"{name}.npz", network)
            print(compare_with_shipped(name, self.networks), flush=True)

    def use(self, *, shipped: bool) -> None:
        """Let samples be drawn with the networks trained so far; with those that ``shipped`` for the missing ones."""
        folder = self.in_use
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        for source in (DATA, self.networks) if shipped else (self.networks,):
            for path in sorted(source.glob("*.npz")):
                shutil.copyfile(path, folder / path.name)
        use_networks(folder)


def compare_with_shipped(name: str, folder: Path) -> str:
    """Return a line on whether a trained network is that of the package, and how far from it otherwise."""
    trained, shipped = folder / f"{name}.npz", DATA / f"{name}.npz"
    if not shipped.is_file():
        return f"{name}: no such network ships"
    if trained.read_bytes() == shipped.read_bytes():
        return f"{name}: the same bytes as the network that ships"
    with np.load(trained) as one, np.load(shipped) as other:
        if {key: one[key].shape for key in one} != {key: other[key].shape for key in other}:
            return f"{name}: has other features or units than the network that ships"
        numbers = [key for key in one if one[key].dtype.kind == "f"]
        most = max(float(np.abs(one[key] - other[key]).max()) for key in numbers)
    return f"{name}: differs from the network that ships by at most {most:.3g} in a weight"


def list_recipes(training: Training) -> list[tuple[tuple[str, ...], Callable[[], dict[str, Network]]]]:
    """Return the names and the recipe of each fit, in the order in which they depend on each other."""
    captures, samples = training.captures, training.samples
    refined = ("refinement", *(name for name in PURPOSES if name.startswith("message_round")))
    return [
        *(
            ((name,), lambda name=name: {name: train_pixels(name, captures, samples)})
            for name in ("initial_confidence", "fast_confidence")
        ),
        (("candidates",), lambda: {"candidates": train_candidates(captures, samples)}),
        (("confidence",), lambda: {"confidence": train_pixels("confidence", captures, samples)}),
        (refined, lambda: train_refinement(captures, samples)),
        (("holes",), lambda: {"holes": train_holes(captures, training.heaps, samples)}),
        (("lumps",), lambda: {"lumps": train_lumps(captures, samples)}),
    ]


@dataclass(frozen=True)
class Subject:
    """A kind of capture that networks are fitted to."""

    folder: str
    """Name of its folder in the work folder."""
    render: Callable[[int, Path], Path]


FRAMES = Subject("captures", render_scenario)
MOVING_HEAPS = Subject("heaps", render_heap)


def render_all(
    subject: Subject, work: Path, numbers: range, reporter: Reporter, workers: WorkerOptions = HERE
) -> list[Path]:
    """Return the captures of a subject, rendered where they are missing."""
    cache = work / subject.folder
    tasks = [(number, cache) for number in numbers]
    Drawing(workers).run(
        subject.render, tasks, lambda done: reporter.step(subject.folder, done, len(numbers))
    )
    return [locate_capture(number, cache) for number in numbers]


def main() -> None:
    """Train what is missing; write all networks and their manifest when none is."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "train")
    parser.add_argument("--captures", type=int, default=CAPTURES)
    parser.add_argument("--heaps", type=int, default=HEAPS)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--ship", action="store_true")
    parser.add_argument("--workers", type=int)
    parser.add_argument("--out", type=Path, default=DATA)
    arguments = parser.parse_args()
    set_deterministic(threads=THREADS)
    reporter, workers = PrintedProgress(), WorkerOptions(arguments.workers)
    work = arguments.work.absolute()
    captures = render_all(FRAMES, work, range(arguments.captures), reporter, workers)
    heaps = render_all(MOVING_HEAPS, work, range(arguments.heaps), reporter, workers)
    training = Training(work, captures, heaps, reporter, workers)
    for names, train in list_recipes(training):
        if not training.is_done(*names) and (not arguments.only or set(names) & set(arguments.only)):
            training.use(shipped=bool(arguments.only))
            training.keep(train())
    if training.is_done(*PURPOSES) if not arguments.only else arguments.ship:
        training.use(shipped=bool(arguments.only))
        assessment = assess(training, arguments.only)
        if arguments.only:
            replace_networks(arguments.only, training.networks, arguments.out, assessment)
        else:
            write_manifest(training.networks, arguments.out, assessment)


def assess(training: Training, names: list[str]) -> Assessment:
    """Return the assessment of these networks, or of all where none is named, on scenarios that are held out."""
    render = partial(render_all, work=training.work, reporter=training.reporter, workers=training.workers)
    captures = render(FRAMES, numbers=range(HELD_OUT, HELD_OUT + ASSESSED))
    heaps = render(MOVING_HEAPS, numbers=range(HELD_OUT, HELD_OUT + HEAPS_ASSESSED))
    cache = SampleCache(training.work / "held_out", training.reporter, training.drawing)
    scores = {preset: assess_reconstruction(captures, preset) for preset in ("standard", "fast")}
    return Assessment(
        len(training.captures),
        ASSESSED,
        assess_networks(captures, heaps, cache, names),
        scores,
        len(training.heaps),
        HEAPS_ASSESSED,
    )


if __name__ == "__main__":
    restart_pinned()
    main()
