"""All commands in their groups, with descriptions and examples, and the interface of a command's module.

A command's module is imported only when it is called.
"""

from __future__ import annotations

import argparse
from argparse import ArgumentParser, RawDescriptionHelpFormatter, _SubParsersAction
from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any, Protocol, cast

from beltscape.core.progress import Reporter


class Command(Protocol):
    """The interface of a command's module."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the command's arguments."""

    def run(self, arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
        """Run the command; return what ``--json`` prints."""
        ...

    def summary(self, result: Mapping[str, Any]) -> str:
        """Return the result in a few readable lines."""
        ...


GROUPS = {
    "designing": {
        "plan": "belt, camera and lens → heights, poses, coverage, depth σ, light, frame rate",
        "target": "speckle pattern for the projector, calibration board to print in true size",
        "simulate": "a rendered capture of a scene, with its exact truth",
        "demo": "the whole chain on a small rig that ships with Beltscape, ending in a report",
    },
    "calibrating": {
        "calibrate": "images of a board → rig.json, calibration.json, report.html",
        "check": "score a rig on board views it has never seen, in px and in mm",
        "export": "rig.json → OpenCV YAML, Kalibr camchain, COLMAP rig, ROS camera_info; a cloud → LAS, LAZ, PLY",
        "import": "one of these → rig.json",
    },
    "measuring": {
        "rectify": "epipolar rectification about the core camera, with the check picture",
        "reconstruct": "images → depth, its uncertainty and a point cloud, frame by frame",
        "measure": "belt, volume, flow, lumps, a module's dimensions",
        "evaluate": "the paper's experiments side by side, a depth map against its truth",
        "view": "a rig, a frame or a sequence in 3-D, with belt and fitted primitives, in the browser",
    },
    "operating": {
        "commission": "from bare cameras to a certificate, step by step: one local page, or the terminal",
        "cameras": "cameras on the network, and whether a project's settings fit them",
        "record": "images from a project's cameras: views of the board by key or timer, sequences of the belt",
        "run": "live: cameras → records → history, alarms and the operator's page",
        "replay": "a recorded capture through the running system, at full or at its own speed",
        "reload": "a running plant reads its settings, rig and empty belt again, without a stop",
        "site": "several belts, each measured by its own run: one page, balances over transfer points, totals",
        "certify": "a material test → errors, factors, densities with σ; a signed certificate, and its verification",
        "explain": "how a total came about: stretches, standings, runs, corrections, alarms, who acknowledged what",
        "budget": "a year's uncertainty of the paid tonne: geometry, zero, speed, density; what would lower it",
        "drift": "how the rig has drifted since its calibration, by ordinary frames; a proposal, taken or undone",
        "users": "who may open the operator's page: list, add, remove, passwords, roles",
        "backup": "history, users, settings, rig, belt and certificates of a plant, while it runs",
        "restore": "a backup back in its place, on this machine or an empty one",
    },
    "reprocessing": {
        "reprocess": "recordings measured again, a year of them on a cluster, into one ledger",
        "compare": "two measurements of the same belt: flow, totals, where and why they differ, with σ",
    },
    "installation": {
        "doctor": "what is installed, and whether this machine suits the job",
        "completion": "completion of commands and options for bash, zsh and fish",
    },
}
"""Group → its commands, each with its description; `commands` has a module for each."""
TITLES = {
    "designing": "Design a rig",
    "calibrating": "Calibrate it",
    "measuring": "Measure captures",
    "operating": "Run a plant",
    "reprocessing": "Measure again",
    "installation": "This installation",
}
"""Group → heading of its commands in ``beltscape --help``."""
COMMANDS = {name: what for group in GROUPS.values() for name, what in group.items()}
"""Command → its description."""


def load_command(name: str) -> Command:
    """Return the module of a command."""
    return import_module(f"beltscape.cli.commands.{name}")  # pyrefly: ignore[bad-return]


EXAMPLES = {
    "plan": ("plan --belt-width 1200 --span 1100 --speed 3 --out plan",),
    "target": (
        "target board --squares 12 9 --square 30 --marker 22 --dictionary DICT_5X5_100 --out board",
        "target pattern --out pattern",
    ),
    "simulate": ("simulate belt_loaded --size quarter --out simulated/loaded",),
    "demo": ("demo --out out/demo",),
    "calibrate": ("calibrate calibration --board board.toml --core cam0 --out rig",),
    "check": ("check calibration_later --rig rig/rig.json --board board.toml",),
    "export": (
        "export rig/rig.json --format opencv --out rig.yaml",
        "export depth_loaded/000 --belt belt.json --out load.laz",
    ),
    "import": ("import camchain.yaml --out rig.json",),
    "rectify": ("rectify loaded --rig rig/rig.json --out rectified",),
    "reconstruct": ("reconstruct loaded --rig rig/rig.json --preset fast --out depth_loaded",),
    "measure": (
        "measure belt depth_empty --out belt.json",
        "measure volume depth_loaded/000 --empty belt.json --along -200 200 --out volume",
        "measure flow moving --rig rig/rig.json --empty belt.json --encoder moving/encoder.csv --out flow",
        "measure lumps depth_loaded/000 --empty belt.json --oversize 60 --out lumps",
        "measure features depth_module/000 --module module.toml --out features",
        "measure zero depth_empty --empty belt.json --out belt_zero.json",
    ),
    "evaluate": ("evaluate depth depth_loaded --truth loaded/truth",),
    "view": ("view depth_loaded --belt belt.json",),
    "commission": (
        "commission plant --set source=trial --step cameras",
        "commission plant",
        "commission plant --step next",
    ),
    "cameras": ("cameras --check project.toml",),
    "record": (
        "record project.toml --out calibration --board board.toml   (space or Enter takes a shot, q ends)",
        "record project.toml --out moving --sequence --seconds 30",
    ),
    "run": ("run project.toml --check", "run project.toml"),
    "replay": ("replay project.toml --capture moving --out replayed",),
    "reload": ("reload project.toml", "reload project.toml --list"),
    "site": ("site site.toml --check", "site site.toml"),
    "certify": (
        "certify material material_test.toml --project project.toml --out test",
        "certify object pass_1 pass_2 pass_3 --module module.toml --sigma 0.05 --project project.toml --out object",
        "certify verify data/certificates/2026-0001.html --project project.toml",
        "certify list project.toml",
    ),
    "explain": (
        "explain project.toml day:2026-11-21 --out explained",
        "explain project.toml 2026-11-21T08:00Z/2026-11-21T09:00Z",
    ),
    "budget": ("budget project.toml year:2026 --out budget",),
    "drift": ("drift project.toml --out drift", "drift project.toml --undo"),
    "users": ("users add project.toml anna --role engineer",),
    "backup": ("backup project.toml /var/backups/beltscape --archive tar.zst --keep 14",),
    "restore": (
        "restore /var/backups/beltscape/2026-11-21T024000Z.tar.zst --check",
        "restore /var/backups/beltscape/2026-11-21T024000Z.tar.zst restored",
    ),
    "reprocess": (
        "reprocess data/recordings --project project.toml --workers 4 --out reprocessed",
        "reprocess s3://plant/2026 --project project.toml --address ray://head:10001 --out reprocessed",
    ),
    "compare": ("compare data reprocessed --out comparison",),
    "doctor": ("doctor --data /var/lib/beltscape",),
    "completion": ("completion bash > ~/.local/share/bash-completion/completions/beltscape",),
}
"""Command → its examples, without the program's name."""


def add_examples(parser: ArgumentParser, command: str) -> None:
    """Put the examples of a command at the end of its help, and of each of its sub-commands those that use it."""
    _add(parser, EXAMPLES[command])
    for action in parser._actions:
        # argparse has no public way to list sub-commands
        if isinstance(action, _SubParsersAction):
            for name, child in cast("dict[str, ArgumentParser]", action.choices).items():
                _add(child, [one for one in EXAMPLES[command] if one.startswith(f"{command} {name} ")])


def _add(parser: ArgumentParser, examples: Sequence[str]) -> None:
    if examples:
        lines = "\n".join(f"  beltscape {example}" for example in examples)
        parser.epilog = f"example{'s' if len(examples) > 1 else ''}:\n{lines}"
        parser.formatter_class = RawDescriptionHelpFormatter
