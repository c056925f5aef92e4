"""``beltscape backup project.toml FOLDER``: a backup of a plant, made while it runs."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("project", type=Path, help="project.toml of the plant, which may be running")
    parser.add_argument("target", type=Path, help="folder of the backups; the new one is named by its time")
    parser.add_argument(
        "--archive", choices=("tar.gz", "tar.zst"), help="write one file (default: a folder with all files)"
    )
    parser.add_argument(
        "--keep", type=int, metavar="N", help="keep the newest N backups and remove the others (default: all)"
    )


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Make the backup."""
    from beltscape.service.backup import make_backup
    from beltscape.service.restoring import check_backup

    backup = make_backup(
        arguments.project, arguments.target, arguments.archive or "folder", arguments.keep, reporter
    )
    manifest = check_backup(backup, reporter)
    size = sum(one.size for one in manifest.files.values())
    return {"backup": backup, "files": len(manifest.files), "bytes": size, "made": manifest.made}


def summary(result: Mapping[str, Any]) -> str:
    """Return the backup's path and size."""
    return f"{result['backup']}: {result['files']} files, {result['bytes'] / 2**20:.1f} MiB, read back and compared"
