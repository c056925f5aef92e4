"""One example of every command, shown at the end of its help."""

from __future__ import annotations

from argparse import (
    ArgumentParser,
    RawDescriptionHelpFormatter,
    _SubParsersAction,  # pyright: ignore[reportPrivateUsage]
)
from collections.abc import Sequence
from typing import cast

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
    "cameras": ("cameras --check project.toml",),
    "record": (
        "record project.toml --out calibration --board board.toml   (space or Enter takes a shot, q ends)",
        "record project.toml --out moving --sequence --seconds 30",
    ),
    "run": ("run project.toml --check", "run project.toml"),
    "replay": ("replay project.toml --capture moving --out replayed",),
    "reload": ("reload project.toml", "reload project.toml --list"),
    "site": ("site site.toml --check", "site site.toml"),
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
        if isinstance(action, _SubParsersAction):  # pyright: ignore[reportPrivateUsage]
            for name, child in cast("dict[str, ArgumentParser]", action.choices).items():
                _add(child, [one for one in EXAMPLES[command] if one.startswith(f"{command} {name} ")])


def _add(parser: ArgumentParser, examples: Sequence[str]) -> None:
    if examples:
        lines = "\n".join(f"  beltscape {example}" for example in examples)
        parser.epilog = f"example{'s' if len(examples) > 1 else ''}:\n{lines}"
        parser.formatter_class = RawDescriptionHelpFormatter
