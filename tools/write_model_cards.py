"""Write docs/reference/models.md: a card of every network that ships, from the registry, its file and the manifest.

python tools/write_model_cards.py
"""

from __future__ import annotations

import json
import textwrap
from pathlib import Path
from typing import Any

from beltscape.learned.network import Network
from beltscape.learned.registry import PURPOSES, Purpose, load_network

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs/reference/models.md"
MANIFEST = ROOT / "src/beltscape/data/networks/manifest.json"
_FEW = 12
"""Largest number of features of which all are named; of more, the first are."""
_WIDTH = 120
"""Characters of a line."""
HEAD = """# Models

Fitted networks decide which pixels are accepted, how accurate they are, and what lies in holes. All are small
multilayer perceptrons with rectifiers (package `learned`), fitted to captures of the simulator with exact truth,
never to photographs and never to the captures that figures are reported for. `make train` at the commit of a
network fits it again from the simulator's seeds. The scenarios have become wider since (cameras, patterns,
materials): networks that were fitted to the wider ones are worse on stones and did not replace these
([Other plants](plants.md#what-limits-small-things-and-few-cameras)). This page is written by
`tools/write_model_cards.py`.
"""


def read_manifest() -> dict[str, Any]:
    """Return the manifest of the last training."""
    return json.loads(MANIFEST.read_text("utf-8"))


def describe_origin(manifest: dict[str, Any]) -> str:
    """Return the paragraph on what the networks were trained on."""
    first, last = manifest["scenarios"]["training"]
    first_held_out, last_held_out = manifest["scenarios"]["held_out"]
    return (
        f"Trained on the scenarios {first} to {last} of `tools/training/scenarios.py`, each drawn from the\n"
        f"seed of its number, at commit {manifest['commit'][:9]}. Scenarios {first_held_out} to "
        f"{last_held_out} were held out. A network that was trained anew\nsince then says so in its card.\n\n"
        + describe_libraries(manifest["made_with"])
        + format_scores(manifest["reconstruction"])
    )


def describe_libraries(made_with: dict[str, str]) -> str:
    """Return the paragraph on the processors and libraries that give these bytes."""
    versions = ", ".join(f"{library} {version}" for library, version in made_with.items())
    sentence = f"The bytes are those of {versions}, on any x86-64 processor with AVX2 from the same captures."
    return textwrap.fill(sentence, _WIDTH) + "\n\n"


def format_scores(scores: dict[str, dict[str, float]]) -> str:
    """Return the table of the reconstruction's mean scores on the held-out scenarios."""
    columns = list(next(iter(scores.values())))
    rows = [
        f"| `{preset}` | " + " | ".join(f"{row[what]:.4g}" for what in columns) + " |"
        for preset, row in scores.items()
    ]
    return "\n".join(
        ["| preset | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|", *rows, ""]
    )


def write_card(name: str, purpose: Purpose, network: Network, manifest: dict[str, Any]) -> str:
    """Return the card of a network as Markdown."""
    units = " → ".join(
        str(size) for size in (len(network.features), *(len(layer) for layer in network.layers))
    )
    named = ", ".join(network.features[:_FEW])
    more = f", … ({len(network.features)} in all)" if len(network.features) > _FEW else ""
    outputs = (
        ", ".join(network.outputs) if len(network.outputs) <= _FEW else f"{len(network.outputs)} numbers"
    )
    rows = [
        ("predicts", purpose.predicts),
        ("outputs", outputs),
        ("inputs", named + more),
        ("units", f"{units}, {network.parameters:,} parameters"),
        ("used by", f"`{purpose.used_by}`"),
        ("not for", purpose.unsuitable),
    ]
    if origin := manifest["networks"][name].get("origin"):
        kinds = [kind for kind in ("scenarios", "moving_heaps") if kind in origin]
        ranges = [(kind.replace("_", " "), *origin[kind]["training"]) for kind in kinds]
        of_what = " and ".join(f"{kind} {first} to {last}" for kind, first, last in ranges)
        rows.append(("trained anew", f"on {of_what}, at commit {origin['commit'][:9]}"))
    metrics = manifest["networks"][name]["metrics"]
    rows += [(f"held out: {what}", f"{value:.4g}") for what, value in metrics.items()]
    return f"## {name}\n\n| | |\n|---|---|\n" + "".join(f"| {what} | {text} |\n" for what, text in rows)


def write_page() -> str:
    """Return the page."""
    manifest = read_manifest()
    cards = [write_card(name, purpose, load_network(name), manifest) for name, purpose in PURPOSES.items()]
    return "\n".join([HEAD, describe_origin(manifest), *cards])


if __name__ == "__main__":
    PAGE.write_text(write_page(), "utf-8")
