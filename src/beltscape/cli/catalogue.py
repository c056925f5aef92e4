"""All commands in their groups, with their descriptions; a command's module is imported only when it is called."""

from __future__ import annotations

from importlib import import_module

from beltscape.cli.command import Command

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
        "cameras": "cameras on the network, and whether a project's settings fit them",
        "record": "images from a project's cameras: views of the board by key or timer, sequences of the belt",
        "run": "live: cameras → records → history, alarms and the operator's page",
        "replay": "a recorded capture through the running system, at full or at its own speed",
        "reload": "a running plant reads its settings, rig and empty belt again, without a stop",
        "site": "several belts, each measured by its own run: one page, balances over transfer points, totals",
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
"""Folder in `commands` → its commands, each with its description."""
TITLES = {
    "designing": "Design a rig",
    "calibrating": "Calibrate it",
    "measuring": "Measure captures",
    "operating": "Run a plant",
    "reprocessing": "Measure again",
    "installation": "This installation",
}
"""Folder in `commands` → heading of its commands in ``beltscape --help``."""
COMMANDS = {name: what for group in GROUPS.values() for name, what in group.items()}
"""Command → its description."""


def load_command(name: str) -> Command:
    """Return the module of a command."""
    (group,) = (group for group, commands in GROUPS.items() if name in commands)
    return import_module(f"beltscape.cli.commands.{group}.{name}")  # pyright: ignore[reportReturnType]
