"""Halves and doubles each tuned constant of matching and measuring; writes docs/reference/constants.md.

    python tools/vary_constants.py docs/reference/constants.md                  # all packages
    python tools/vary_constants.py table.md stereo.multiview          # one package

The constants are varied one at a time on simulated captures of 612 × 512 px, against their
truth. It takes an hour or two on two cores; packages can be run one after the other into the same file.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import importlib
import io
import json
import math
import os
import pkgutil
import sys
import tempfile
from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

import beltscape
from beltscape.cli.main import main as beltscape_main
from beltscape.kernels import load
from result_digests import DEMO, MOVING

Figures = dict[str, float]
NOT_TUNED = {"FEATURE_COUNT", "FINES", "R10_MM"}
"""Numbers that follow from others, codes, and a standard's series."""
MODULES = {"kernels": ("beltscape.kernels.holes",)}
"""Of these packages only some modules are varied."""
SEED = 5
"""Seed of the captures."""


@dataclass(frozen=True, slots=True)
class Constant:
    """A numeric constant of a module."""

    module: str
    name: str
    value: Any
    """A number, or a tuple or array of numbers."""

    def scaled(self, factor: float) -> Any:
        """Return the value times ``factor``; a whole number stays whole and keeps its parity, at least 1."""
        return _scale(self.value, factor)


def _scale(value: Any, factor: float) -> Any:
    if isinstance(value, tuple):
        return tuple(_scale(one, factor) for one in cast("tuple[Any, ...]", value))
    if isinstance(value, int):
        half = int(value * factor)
        return max(1, half + (half - value) % 2) if value else 0
    return value * factor


def _is_tunable(value: Any) -> bool:
    if isinstance(value, tuple):
        parts = cast("tuple[Any, ...]", value)
        return len(parts) > 0 and all(not isinstance(one, tuple) and _is_tunable(one) for one in parts)
    if isinstance(value, np.ndarray):
        return cast("NDArray[Any]", value).dtype.kind == "f"
    return isinstance(value, int | float | np.floating) and not isinstance(value, bool)


def find_constants(package: str) -> list[Constant]:
    """Return the numeric constants of ``beltscape.<package>`` in the order of modules and lines."""
    top = importlib.import_module(f"beltscape.{package}")
    names = [top.__name__] + (
        [found.name for found in pkgutil.walk_packages(top.__path__, f"{top.__name__}.")]
        if hasattr(top, "__path__")
        else []
    )
    found: list[Constant] = []
    for name in MODULES.get(package, names):
        module = importlib.import_module(name)
        for target in _assigned_names(module):
            value = getattr(module, target, None)
            if target.isupper() and target not in NOT_TUNED and _is_tunable(value):
                found.append(Constant(name, target, value))
    return found


def _assigned_names(module: ModuleType) -> list[str]:
    assert module.__file__ is not None
    assigned: list[str] = []
    for statement in ast.parse(Path(module.__file__).read_text()).body:
        targets = statement.targets if isinstance(statement, ast.Assign) else []
        for target in targets:
            names = target.elts if isinstance(target, ast.Tuple) else [target]
            assigned += [one.id for one in names if isinstance(one, ast.Name)]
    return assigned


@contextlib.contextmanager
def replaced(constant: Constant, value: Any) -> Generator[None]:
    """Replace a constant in its module and in those that import it."""
    holders = [
        module
        for name, module in list(sys.modules.items())
        if name.startswith("beltscape") and getattr(module, constant.name, None) is constant.value
    ]
    for module in holders:
        setattr(module, constant.name, value)
    try:
        yield
    finally:
        for module in holders:
            setattr(module, constant.name, constant.value)


def run_command(*arguments: object) -> Mapping[str, Any]:
    """Run a command; return its JSON answer. ValueError with its message if it is refused."""
    printed, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(errors):
        code = beltscape_main([*map(str, arguments), "--json"])
    if code != 0:
        raise ValueError(errors.getvalue().strip().splitlines()[-1])
    return json.loads(printed.getvalue())


class Chain:
    """The measurements, each repeated alone on the results of the steps before it."""

    def __init__(self, out: Path) -> None:
        """Render the scenes and reconstruct them, where ``out`` does not hold them already."""
        self.out = out
        self.truth, self.heap, self.empty = out / "belt_loaded/truth", out / "heap", out / "empty/000"
        out.mkdir(parents=True, exist_ok=True)
        (out / "belt_moving.toml").write_text(MOVING)
        if not (out / "belt_moving").exists():
            run_command("simulate", out / "belt_moving.toml", "--out", out / "belt_moving")
        for scene, folder in (("belt_empty", "empty"), ("belt_loaded", "heap"), ("module", "solids")):
            if not (out / folder).exists():
                run_command("simulate", scene, "--size", "quarter", "--seed", SEED, "--out", out / scene)
                rig = out / scene / "truth/rig.json"
                run_command("reconstruct", out / scene, "--rig", rig, "--out", out / folder)

    def match(self) -> Figures:
        """Reconstruct the heap and compare it with the truth."""
        varied = self.out / "matched"
        run_command(
            "reconstruct", self.out / "belt_loaded", "--rig", self.truth / "rig.json", "--out", varied
        )
        score = run_command("evaluate", "depth", varied, "--truth", self.truth)["frames"][0]["regions"]["all"]
        return {
            "measured %": 100 * score["coverage"],
            "< 0.25 mm %": 100 * score["within_quarter_mm"],
            "gross %": 100 * score["gross"],
            "σ ratio": score["sigma_ratio"],
        }

    def measure_volume(self) -> Figures:
        """Measure the volume of the heap."""
        volume = run_command("measure", "volume", self.heap / "000", "--empty", self.empty, "--along", "-200", "200",
                             "--out", self.out / "volume")  # fmt: skip
        true_mm3 = json.loads((self.truth / "belt_loaded_scene.json").read_text())["volume"]["volume_mm3"]
        return {
            "error %": 100 * (volume["volume_mm3"] / true_mm3 - 1),
            "σ %": 100 * volume["sigma_mm3"] / true_mm3,
        }

    def measure_volume_by_reference(self) -> Figures:
        """Measure the volume of the heap by the reference kernels: the native ones have their constants in C++."""
        os.environ["BELTSCAPE_KERNELS"] = "reference"
        load.cache_clear()
        try:
            return self.measure_volume()
        finally:
            del os.environ["BELTSCAPE_KERNELS"]
            load.cache_clear()

    def measure_lumps(self) -> Figures:
        """Measure the lumps of the heap and compare them with its rocks."""
        score = run_command("evaluate", "lumps", self.heap / "000", "--truth", self.truth)
        return {
            "recall %": 100 * score["recall"],
            "precision %": 100 * score["precision"],
            "size error %": 100 * score["size_error"],
            "d50 mm": score["d50_mm"],
        }

    def measure_features(self) -> Figures:
        """Measure the calibration module; its dimensions are known."""
        answer = run_command("measure", "features", self.out / "solids/000", "--module", DEMO.parent / "module.toml",
                             "--out", self.out / "features")  # fmt: skip
        rows = [row for row in answer["features"] if row["measured_mm"] is not None]
        off = [row["measured_mm"] - row["nominal_mm"] for row in rows]
        ratio = [deviation / row["sigma_mm"] for deviation, row in zip(off, rows, strict=True)]
        return {"dimensions": float(len(off)), "RMS mm": _rms(off), "RMS/σ": _rms(ratio)}

    def measure_flow(self) -> Figures:
        """Measure a moving belt without its encoder."""
        moving = self.out / "belt_moving"
        answer = run_command("measure", "flow", moving, "--rig", moving / "truth/rig.json", "--empty", self.empty,
                             "--preset", "fast", "--out", self.out / "flow")  # fmt: skip
        totals = answer["totals"]
        return {
            "volume dm³": totals["volume_mm3"] * 1e-6,
            "σ dm³": totals["sigma_mm3"] * 1e-6,
            "length mm": totals["length_mm"],
        }


PACKAGES: dict[str, Callable[[Chain], Figures]] = {
    "stereo.multiview": Chain.match,
    "measure.belt": Chain.measure_volume,
    "measure.volume": Chain.measure_volume,
    "kernels": Chain.measure_volume_by_reference,
    "measure.lumps": Chain.measure_lumps,
    "measure.features": Chain.measure_features,
    "measure.flow": Chain.measure_flow,
}
"""Package → the measurement that shows the effect of its constants."""


def _rms(values: list[float]) -> float:
    return math.sqrt(sum(value**2 for value in values) / len(values)) if values else math.nan


def describe_change(before: Figures, after: Figures) -> str:
    """Return the figures that changed in the digits shown."""
    changed = [
        f"{name} {after[name]:.4g}" for name in before if f"{before[name]:.4g}" != f"{after[name]:.4g}"
    ]
    return ", ".join(changed) or "–"


def vary(constant: Constant, factor: float, measure: Callable[[], Figures], before: Figures) -> str:
    """Return what changes with ``factor`` times the constant."""
    try:
        with replaced(constant, constant.scaled(factor)), np.errstate(all="ignore"):
            return describe_change(before, measure())
    except Exception as error:  # an invalid value fails in its own way; the table says so
        return f"fails ({type(error).__name__})"


def make_table(package: str, chain: Chain) -> Iterator[str]:
    """Yield the lines of a package's table."""
    measure = PACKAGES[package].__get__(chain)
    before = measure()
    figures = ", ".join(f"{name} {value:.4g}" for name, value in before.items())
    yield f"Beltscape {beltscape.__version__}: {figures}.\n"
    yield "| constant | value | halved | doubled |\n|---|---|---|---|"
    for constant in find_constants(package):
        place = constant.module.removeprefix(f"beltscape.{package}").removeprefix(".") or package
        value = np.array2string(np.asarray(constant.value), precision=4, threshold=8, separator=", ").replace(
            "\n", ""
        )
        effects = " | ".join(vary(constant, factor, measure, before) for factor in (0.5, 2.0))
        print(f"{place}.{constant.name}: {effects}", file=sys.stderr, flush=True)
        yield f"| `{place}.{constant.name}` | {value} | {effects} |"


HEAD = """# Tuned constants

What halving and doubling each constant of a package changes, one at a time: the output of `python
tools/vary_constants.py docs/reference/constants.md PACKAGE`. Of matching and measuring, the packages below have been
varied. The captures are a simulated heap, an empty belt and a module (`--size quarter --seed 5`, 612 × 512 px), and
six frames of a moving belt. Matching, volume and lumps are compared with their truth, features with the nominal
dimensions. Where a table is missing, the constants' docstrings say what is known.

A dash means that no figure changes in four digits: the constant is a limit that these captures do not reach, or its
value does not matter between half and double. "fails" means that the value is invalid. Constants of networks'
features must have the values with which the networks were fitted.
"""


def main() -> int:
    """Write the tables of the packages; those of other packages in the file stay."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("out", type=Path, help="Markdown file")
    parser.add_argument("package", nargs="*", help=f"of {', '.join(PACKAGES)} (default: all)")
    parser.add_argument("--work", type=Path, help="folder that keeps the captures for another run")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        chain = Chain(arguments.work or Path(folder))
        for package in arguments.package or PACKAGES:
            write_section(arguments.out, package, "\n".join(make_table(package, chain)))
    return 0


def write_section(path: Path, package: str, section: str) -> None:
    """Replace a package's section of the file; sections stand in the order of `PACKAGES`."""
    parts = path.read_text().split("\n## ")[1:] if path.is_file() else []
    sections = {part.split("\n", 1)[0]: part.split("\n", 1)[1].strip() for part in parts}
    sections[package] = section
    ordered = [f"## {name}\n\n{sections[name]}\n" for name in PACKAGES if name in sections]
    path.write_text("\n".join([HEAD, *ordered]))


if __name__ == "__main__":
    sys.exit(main())
