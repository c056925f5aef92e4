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


def write_manifest(networks: Path, out: Path, assessment: Assessment) -> None:
    """Copy the networks of a training to a folder, with manifest.json."""
    commit = _read_commit()  # before this training's own files change the working tree
    out.mkdir(parents=True, exist_ok=True)
    entries: dict[str, Any] = {}
    for name in PURPOSES:
        path = networks / f"{name}.npz"
        with path.open("rb") as stream:
            network = read_network(stream, path.name)
        entries[name] = {
            "features": len(network.features),
            "units": [len(layer) for layer in network.layers],
            "parameters": network.parameters,
            "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
            "metrics": _round(assessment.networks.get(name, {})),
        }
        shutil.copyfile(path, out / path.name)
    document = {
        "made_by": "make train",
        "commit": commit,
        "made_with": {library: importlib.metadata.version(library) for library in MADE_WITH},
        "scenarios": {
            "training": [0, assessment.trained - 1],
            "held_out": [HELD_OUT, HELD_OUT + assessment.held_out - 1],
        },
        "reconstruction": {preset: _round(scores) for preset, scores in assessment.reconstruction.items()},
        "networks": entries,
    }
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
