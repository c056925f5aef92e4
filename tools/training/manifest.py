"""The manifest of the shipped networks: their training scenarios, the commit of the code, and their metrics."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from beltscape.learned.network import read_network
from beltscape.learned.registry import PURPOSES
from training.scenarios import HELD_OUT

MADE_WITH = "numpy", "scipy", "opencv-python-headless", "embreex", "mitsuba", "torch"
"""Libraries on whose versions the bytes of the networks depend."""


@dataclass(frozen=True, slots=True)
class Assessment:
    """What the networks were trained and assessed on, and the metrics."""

    trained: int
    """Number of training scenarios, from 0 on."""
    held_out: int
    """Number of held-out scenarios, from `HELD_OUT` on."""
    networks: dict[str, dict[str, float]]
    """Metrics by network."""
    reconstruction: dict[str, dict[str, float]]
    """Scores of the reconstruction with all of them, by preset."""
    heaps: int = 0
    """Number of moving heaps trained on, from 0 on."""
    heaps_held_out: int = 0
    """Number of held-out moving heaps, from `HELD_OUT` on."""


def write_manifest(networks: Path, out: Path, assessment: Assessment) -> None:
    """Copy the networks of a training to a folder, with manifest.json."""
    document = describe_origin(assessment) | {
        "reconstruction": {preset: _round(scores) for preset, scores in assessment.reconstruction.items()},
        "networks": {name: _take_over(name, networks, out, assessment) for name in PURPOSES},
    }
    _write(out, document)


def replace_networks(names: list[str], networks: Path, out: Path, assessment: Assessment) -> None:
    """Copy some networks of a training over those of a folder; its manifest gives each an origin of its own."""
    document = json.loads((out / "manifest.json").read_text("utf-8"))
    origin = describe_origin(assessment)
    for name in names:
        document["networks"][name] = _take_over(name, networks, out, assessment) | {"origin": origin}
    document["reconstruction"] = {
        preset: _round(scores) for preset, scores in assessment.reconstruction.items()
    }
    _write(out, document)


def describe_origin(assessment: Assessment) -> dict[str, Any]:
    """Return what the bytes of this training's networks depend on."""
    return {
        "made_by": "make train",
        "commit": _read_commit(),
        "made_with": {library: importlib.metadata.version(library) for library in MADE_WITH},
        "scenarios": {
            "training": [0, assessment.trained - 1],
            "held_out": [HELD_OUT, HELD_OUT + assessment.held_out - 1],
        },
        "moving_heaps": {
            "training": [0, assessment.heaps - 1],
            "held_out": [HELD_OUT, HELD_OUT + assessment.heaps_held_out - 1],
        },
    }


def _take_over(name: str, networks: Path, out: Path, assessment: Assessment) -> dict[str, Any]:
    """Copy a network to a folder and return its entry of the manifest."""
    path = networks / f"{name}.npz"
    with path.open("rb") as stream:
        network = read_network(stream, path.name)
    out.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(path, out / path.name)
    return {
        "features": len(network.features),
        "units": [len(layer) for layer in network.layers],
        "parameters": network.parameters,
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "metrics": _round(assessment.networks.get(name, {})),
    }


def _write(out: Path, document: dict[str, Any]) -> None:
    (out / "manifest.json").write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", "utf-8")


def _round(metrics: dict[str, float]) -> dict[str, float]:
    return {what: float(f"{value:.4g}") for what, value in metrics.items()}


def _read_commit() -> str:
    """Return the commit of the working tree, with a + if files are changed; "unknown" outside a repository."""

    def run(*arguments: str) -> str:
        command = ["git", *arguments]
        folder = Path(__file__).parent
        return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout.strip()

    try:
        return run("rev-parse", "HEAD") + (
            "+" if run("status", "--porcelain", "--untracked-files=no") else ""
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
