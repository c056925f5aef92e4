"""Builds the wheel for glibc 2.28 and newer: ``python tools/build_wheel.py OUT``, in an environment with wheel.lock.

The compiler is clang from the package ziglang, which links against the symbols of any glibc; a wheel of the system's
compiler asks for the glibc of this machine. auditwheel verifies the tag. The kernels give the same bytes as with GCC:
``tools/compare_kernels.py`` shows it.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
GLIBC = "2.28"
"""Of 2018: Debian 10, RHEL 8, Ubuntu 20.04 and newer have it."""
MOST_MB = 15.0
"""Largest wheel that is handed out."""
_COMPILER = """#!/bin/sh
# clang writes x86-64-v3 with underscores
for word; do
    shift
    case $word in -march=x86-64-v*) word=-march=x86_64_v${{word##*-v}} ;; esac
    set -- "$@" "$word"
done
exec "{python}" -m ziglang {language} -target {target} "$@"
"""


def build(out: Path, target: str) -> Path:
    """Build the source archive, the wheel from it, and repair that; return the wheel's path."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        compilers = {"CC": "cc", "CXX": "c++"}
        for variable, language in compilers.items():
            path = folder / variable
            path.write_text(_COMPILER.format(python=sys.executable, language=language, target=target))
            path.chmod(0o755)
        tools = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        environment = {**os.environ, **{name: str(folder / name) for name in compilers}, "PATH": tools}
        run = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), str(ROOT)]
        subprocess.run(run, env=environment, check=True, cwd=folder)
        (built,), (archive,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
        out.mkdir(parents=True, exist_ok=True)
        shutil.copy(archive, out)
        platform = f"manylinux_{GLIBC.replace('.', '_')}_x86_64"
        repair = ["auditwheel", "repair", "--only-plat", "--plat", platform, "-w", str(out), str(built)]
        subprocess.run(repair, env=environment, check=True)
    return max(out.glob("*.whl"), key=lambda path: path.stat().st_mtime)


def main() -> int:
    """Build the wheel, and fail if it is too large."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    wheel = build(parser.parse_args().out.resolve(), f"x86_64-linux-gnu.{GLIBC}")
    size = wheel.stat().st_size / 1e6
    print(f"{wheel}  {size:.1f} MB")
    if size > MOST_MB:
        print(f"larger than {MOST_MB:g} MB", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
