"""Digests of every number the program computes on its shipped capture, to show that a change changes no result.

    python tools/result_digests.py before.json                    # on the state before
    python tools/result_digests.py after.json --against before.json   # ends with 1 where a number differs

Only the program's commands are run, so the code behind them can be renamed and moved. Depth maps, clouds, tables
and JSON documents count; texts (warnings, HTML, file paths) do not. Digests of two machines may differ: processors
without fused multiply-add and other versions of libraries round differently.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import json
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import beltscape
from beltscape.cli.main import main as beltscape_main

DEMO = Path(beltscape.__file__).parent / "data" / "demo"
MOVING = """
kind = "belt_moving"
frames = 6
[rig]
scale = 0.25
[motion]
speed_mm_s = 800
frames_per_s = 10
start_mm = -250
[render]
passes = 1
oversample = 1
ambient_samples = 1
"""
NUMERIC = {".tiff", ".ply", ".csv", ".json", ".stl", ".npz"}
TEXT_KEYS = {
    "warnings",
    "message",
    "messages",
    "advice",
    "version",
    "commit",
    "duration_s",
    "seconds_per_frame",
    "created",
}
"""Keys of JSON documents whose values are prose, or differ from run to run."""


def commands(out: Path) -> Iterator[tuple[str, list[Any]]]:
    """Yield a name and the arguments of each step, in the reader's order."""
    rig, empty, loaded = out / "rig" / "rig.json", out / "empty", out / "loaded"
    yield "calibrate", ["calibrate", DEMO / "calibration", "--board", DEMO / "board.toml", "--core", "cam0",
                        "--out", out / "rig"]  # fmt: skip
    yield "check", ["check", DEMO / "calibration", "--rig", rig, "--board", DEMO / "board.toml"]
    yield "rectify", ["rectify", DEMO / "belt_loaded", "--rig", rig, "--out", out / "rectified"]
    for scene, folder in (("belt_empty", empty), ("belt_loaded", loaded), ("module", out / "module")):
        yield scene, ["reconstruct", DEMO / scene, "--rig", rig, "--out", folder]
    yield "fast", ["reconstruct", DEMO / "belt_loaded", "--rig", rig, "--preset", "fast",
                   "--out", out / "loaded_fast"]  # fmt: skip
    yield "pairwise", ["reconstruct", DEMO / "belt_loaded", "--rig", rig, "--method", "pairwise",
                       "--out", out / "loaded_pairwise"]  # fmt: skip
    yield "belt", ["measure", "belt", empty, "--out", out / "belt.json"]
    yield "volume", ["measure", "volume", loaded / "000", "--empty", empty / "000", "--along", "-200", "200",
                     "--out", out / "volume"]  # fmt: skip
    yield "lumps", ["measure", "lumps", loaded / "000", "--empty", empty / "000", "--out", out / "lumps"]
    yield "features", ["measure", "features", out / "module" / "000", "--module", DEMO / "module.toml",
                       "--out", out / "features"]  # fmt: skip
    moving, true_rig = out / "moving", out / "moving" / "truth" / "rig.json"
    yield "simulate", ["simulate", out / "moving.toml", "--out", moving]
    yield "still", ["simulate", "belt_empty", "--size", "quarter", "--out", out / "still"]
    yield "ground", ["reconstruct", out / "still", "--rig", true_rig, "--out", out / "ground"]
    for name, encoder in (("flow", ["--encoder", moving / "encoder.csv"]), ("flow_without_encoder", [])):
        yield name, ["measure", "flow", moving, "--rig", true_rig, "--empty", out / "ground" / "000", *encoder,
                     "--preset", "fast", "--density", "1600", "--out", out / name]  # fmt: skip


def digest_file(path: Path, root: Path) -> str:
    """Return the digest of a file's numbers."""
    data = path.read_bytes()
    if path.suffix == ".json":
        document = without_text(json.loads(data), str(root))
        data = json.dumps(document, sort_keys=True).encode()
    return hashlib.sha256(data).hexdigest()[:16]


def without_text(value: Any, root: str) -> Any:
    """Return a JSON value without prose and without paths of this run."""
    if isinstance(value, Mapping):
        return {key: without_text(one, root) for key, one in value.items() if key not in TEXT_KEYS}
    if isinstance(value, list):
        return [without_text(one, root) for one in value]
    return value.replace(root, "") if isinstance(value, str) else value


def run_step(name: str, arguments: list[Any], out: Path) -> dict[str, str]:
    """Run one command; return the digest of its JSON answer."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        code = beltscape_main([*map(str, arguments), "--json"])
    if code != 0:
        raise SystemExit(f"{name}: beltscape {' '.join(map(str, arguments))} ended with {code}")
    answer = without_text(json.loads(printed.getvalue()), str(out))
    text = json.dumps(answer, sort_keys=True)
    return {f"{name} --json": hashlib.sha256(text.encode()).hexdigest()[:16]}


def compute_digests(out: Path) -> dict[str, str]:
    """Run the whole chain into ``out``; return a digest by file and by answer."""
    (out / "moving.toml").write_text(MOVING)
    digests: dict[str, str] = {}
    for name, arguments in commands(out):
        digests |= run_step(name, arguments, out)
        print(name, file=sys.stderr)
    for path in sorted(out.rglob("*")):
        if path.suffix in NUMERIC and "manifest" not in path.name:
            digests[str(path.relative_to(out))] = digest_file(path, out)
    return digests


def main() -> int:
    """Write the digests, and name those that differ from an earlier file's."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("out", type=Path, help="file for the digests")
    parser.add_argument("--against", type=Path, help="digests of another state")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        digests = compute_digests(Path(folder))
    arguments.out.write_text(json.dumps(digests, indent=1) + "\n")
    if arguments.against is None:
        return 0
    before = json.loads(arguments.against.read_text())
    differing = [name for name in sorted(before | digests) if before.get(name) != digests.get(name)]
    print("\n".join([*differing, f"{len(differing)} of {len(before)} differ"]))
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
