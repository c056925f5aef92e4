"""Sets of fitted networks in one matcher, compared at equal shares of gross errors instead of at a threshold.

    python benchmarks/networks.py FOLDER … [--rendered RENDERED] [--scenes TEXT …] [--preset NAME] [--gross SHARE …]
                                           [--cache CACHE]

Each FOLDER holds networks, NAME.npz, that take the place of those that ship; *shipped* is in every table. The scenes
are those of axes.py, rendered once, and with --rendered those of another renderer at full and at half size. Every
surface that a set of networks finds is sorted by its confidence. A column states the share of all true pixels that
are within 1 mm and accepted, at the lowest threshold at which the given share of the accepted is off by over 5 mm.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

import beltscape
from axes import CACHE, list_scenarios, read_scene
from beltscape.core.progress import Silent
from beltscape.evaluate.depth_scores import GROSS_MM
from beltscape.learned.registry import use_networks
from beltscape.stereo.multiview.depth_range import find_depth_range
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.settings import MultiviewSettings
from captures import Scene, read_rendered
from tables import format_cells, format_head

SHIPPED = Path(beltscape.__file__).parent / "data" / "networks"
RENDERED = [("belt_loaded", 0), ("belt_loaded", 1), ("module", 0)]
"""Scenes of another renderer: kinds, and how often their images are halved."""
_ALL = 0.02
"""Least confidence with which the scenes are matched: what is less sure is wrong nearly always."""
_NEAR_MM = 1.0


def compute_shares_at_gross(
    error_mm: np.ndarray, confidence: np.ndarray, gross: Sequence[float]
) -> list[float]:
    """Return the shares of true pixels within 1 mm at shares of gross errors among the accepted ones.

    ``error_mm`` (N,) holds the absolute errors of all true pixels, NaN where nothing is measured. 0 where even the
    surest pixels are worse.
    """
    measured = np.isfinite(error_mm)
    order = np.argsort(-confidence[measured], kind="stable")
    error = error_mm[measured][order]
    wrong = np.cumsum(error > GROSS_MM) / np.arange(1, len(error) + 1)
    near = np.cumsum(error < _NEAR_MM) / len(error_mm)
    return [float(near[wrong <= most][-1]) if (wrong <= most).any() else 0.0 for most in gross]


def list_scenes(names: Sequence[str], rendered: Path | None, cache: Path) -> Iterator[Scene]:
    """Yield the scenes whose name contains one of these texts."""
    for name, scenario in list_scenarios().items():
        if any(text in name for text in names):
            yield read_scene(name, scenario, cache).scene
    if rendered is None:
        return
    for kind, halvings in RENDERED:
        scene = read_rendered(rendered, kind, halvings)
        if any(text in scene.name for text in names):
            yield scene


@contextmanager
def use_set(networks: Path | None) -> Generator[None]:
    """Let the matcher use the networks that ship, and those of a folder in place of them."""
    with tempfile.TemporaryDirectory() as folder:
        for source in [SHIPPED, *([networks] if networks else [])]:
            for path in source.glob("*.npz"):
                shutil.copyfile(path, Path(folder) / path.name)
        use_networks(Path(folder))
        try:
            yield
        finally:
            use_networks(SHIPPED)


def match(scene: Scene, preset: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the absolute errors of a scene's true pixels in mm, NaN where unmeasured, and their confidences."""
    settings = MultiviewSettings.preset(preset).model_copy(update={"least_confidence": _ALL})
    near_far = find_depth_range(scene.rig, scene.frame, Silent())
    depth = MultiviewReconstructor(scene.rig, near_far, settings).reconstruct(scene.frame, Silent())
    known = scene.region & np.isfinite(scene.true_depth_mm)
    error = np.abs(depth.depth_mm.astype(np.float64) - scene.true_depth_mm)
    return error[known], depth.confidence[known]


def compare(scene: Scene, sets: Sequence[Path | None], preset: str, gross: Sequence[float]) -> Iterator[str]:
    """Yield the rows of a scene, one for each set of networks."""
    for networks in sets:
        with use_set(networks):
            shares = compute_shares_at_gross(*match(scene, preset), gross)
        name = networks.name if networks else "shipped"
        yield format_cells((f"{scene.name}, {scene.size}", name, *(f"{share:.1%}" for share in shares)))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("networks", nargs="*", type=Path)
    parser.add_argument("--rendered", type=Path)
    parser.add_argument("--scenes", nargs="*", default=[""])
    parser.add_argument("--preset", default="standard")
    parser.add_argument("--gross", nargs="*", type=float, default=[0.005, 0.01])
    parser.add_argument("--cache", type=Path, default=CACHE)
    chosen = parser.parse_args()
    columns = [f"< 1 mm at {share:.1%} gross" for share in chosen.gross]
    print("\n".join(format_head(("scene", "networks", *columns))))
    for scene in list_scenes(chosen.scenes, chosen.rendered, chosen.cache):
        for row in compare(scene, [None, *chosen.networks], chosen.preset, chosen.gross):
            print(row, flush=True)


if __name__ == "__main__":
    main()
