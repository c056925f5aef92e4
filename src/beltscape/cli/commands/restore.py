"""``beltscape restore BACKUP FOLDER``: puts a backup back in its place, on this machine or on another."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("backup", type=Path, help="a folder or an archive of beltscape backup")
    parser.add_argument(
        "folder", type=Path, nargs="?", help="folder for project.toml and what lies beside it"
    )
    parser.add_argument(
        "--data", type=Path, metavar="FOLDER", help="another data folder than project.toml names"
    )
    parser.add_argument(
        "--replace", action="store_true", help="rename what is there already, instead of refusing"
    )
    parser.add_argument("--check", action="store_true", help="only compare all files with their SHA-256")


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Check the backup and put it in its place."""
    from beltscape.core.errors import InputError
    from beltscape.service.restoring import check_backup, restore_backup

    if arguments.check:
        manifest = check_backup(arguments.backup, reporter)
        found = {"made": manifest.made, "program": manifest.program, "files": len(manifest.files)}
        return {"backup": arguments.backup, "checked": True, **found}
    if arguments.folder is None:
        raise InputError("restore: give the folder for project.toml, or --check")
    done = restore_backup(
        arguments.backup, arguments.folder, arguments.data, reporter, replace=arguments.replace
    )
    return {
        "backup": arguments.backup,
        "made": done.manifest.made,
        "program": done.manifest.program,
        "files": len(done.manifest.files),
        "bytes": done.size_bytes,
        "project": done.project,
        "data": done.data,
        "moved_aside": list(done.moved_aside),
    }


def summary(result: Mapping[str, Any]) -> str:
    """Return what was restored, and the next step."""
    made = f"of {result['made']} by beltscape {result['program']}, {result['files']} files"
    if result.get("checked"):
        return f"{result['backup']}: {made}, all sound"
    lines = [f"restored the backup {made}", f"project {result['project']}", f"data    {result['data']}"]
    lines += [f"what was there is now {path}" for path in result["moved_aside"]]
    return "\n".join([*lines, f"next: beltscape run --check {result['project']}"])
