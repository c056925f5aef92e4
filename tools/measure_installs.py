"""Measure what each install of a wheel takes: ``python tools/measure_installs.py dist/beltscape-*.whl``.

Every extra is installed into a fresh virtual environment, whose bytes and packages are counted, without those of an
empty environment. ``pip check`` must find no conflict. The table goes to standard output, for docs/install.md.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

EXTRAS = ("", "export", "modbus", "mqtt", "opcua", "live", "site", "simulate", "cluster", "viewer", "all")
"""The wheel alone, and its extras that need no system library."""
MB = 1e6
"""Bytes of the unit that disks are sold in."""


def measure(wheel: Path, extra: str) -> tuple[float, int]:
    """Return the megabytes and the number of packages that an install adds to an empty environment.

    Files that Python compiles (``__pycache__``) count, since pip makes them.
    """
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
        before = count_bytes(folder), count_packages(folder)
        run_pip(folder, "install", "--quiet", f"{wheel}[{extra}]" if extra else str(wheel))
        run_pip(folder, "check")
        return (count_bytes(folder) - before[0]) / MB, count_packages(folder) - before[1]


def run_pip(folder: Path, *words: str) -> None:
    """Run pip in an environment; its output goes to standard error."""
    pip = [str(folder / "bin/python"), "-m", "pip", "--disable-pip-version-check", *words]
    subprocess.run(pip, check=True, stdout=sys.stderr)


def count_bytes(folder: Path) -> int:
    """Return the bytes of all files of a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file() and not path.is_symlink())


def count_packages(folder: Path) -> int:
    """Return the number of distributions that are installed."""
    return len([*folder.glob("lib/python*/site-packages/*.dist-info")])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("wheel", type=Path)
    wheel = parser.parse_args().wheel.resolve()
    sys.stdout.write("| install | on disk | packages |\n|---|---|---|\n")
    for extra in EXTRAS:
        size_mb, packages = measure(wheel, extra)
        name = f"beltscape[{extra}]" if extra else "beltscape"
        sys.stdout.write(f"| `{name}` | {size_mb:.0f} MB | {packages} |\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
