"""Benchmark of what an engineer chooses: number of cameras, image width and preset, on the rendered captures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.measure.belt.empty_belt import find_belt
from beltscape.measure.volume.settings import VolumeSettings
from beltscape.measure.volume.volume import measure_volume
from beltscape.stereo.multiview.depth_range import find_depth_range
from captures import Scene, read_rendered
from matching.methods import MULTIVIEW, Range, Result, run
from tables import format_cells, format_head

RIGS: dict[str, Sequence[str]] = {
    "2: one auxiliary across": ("cam1",),
    "2: one auxiliary along": ("cam2",),
    "3: an L, across and along": ("cam1", "cam2"),
    "3: a line across": ("cam1", "cam3"),
    "4": ("cam1", "cam2", "cam3"),
    "5: a cross (the paper's)": ("cam1", "cam2", "cam3", "cam4"),
}
"""The auxiliaries of each rig; the core is the same."""
SIZES = {1224: 0, 612: 1, 306: 2}
"""Image widths, px, with the number of halvings of the rendered images."""
NOTES = """\
The rendered loaded belt (`belt_loaded`) and its empty belt, with exact rigs, by rigs that use some of its
five cameras. Depth: as in "Whole frames". Volume: error of the heap of 12.9 l, the belt learned with the same rig,
and its claimed σ."""
_COLUMNS = (
    "cameras", "width px", "preset", "< 1 mm", "< 0.25 mm", "gross", "measured", "median mm", "σ ratio", "volume",
    "σ of volume",
)  # fmt: skip


def choices(folder: Path) -> list[str]:
    """Return the tables of rigs, and of widths and presets."""
    rigs = [_row(folder, name, 1224, "standard") for name in RIGS]
    widths = [
        _row(folder, "5: a cross (the paper's)", width, preset) for width in SIZES for preset in MULTIVIEW
    ]
    heads = ("### Number of cameras", "### Image width and preset")
    return [NOTES, "", *_format(heads[0], rigs), "", *_format(heads[1], widths)]


def _format(heading: str, rows: Sequence[str]) -> Iterator[str]:
    yield from (heading, "", *format_head(_COLUMNS), *rows)


def _row(folder: Path, cameras: str, width_px: int, preset: str) -> str:
    loaded, empty = (
        select_cameras(read_rendered(folder, name, SIZES[width_px]), RIGS[cameras])
        for name in ("belt_loaded", "belt_empty")
    )
    result = run(preset, loaded, _find_range(loaded), timed=False)
    error, sigma = _volume(loaded, result, run(preset, empty, _find_range(empty), timed=False))
    s = result.score
    cells = [
        cameras, str(width_px), preset, f"{s.within_1mm:.1%}", f"{s.within_quarter_mm:.1%}", f"{s.gross:.2%}",
        f"{s.coverage:.1%}", f"{s.interior_median_mm:.3f}", f"{s.sigma_ratio:.2f}", f"{error:+.2%}", f"{sigma:.2%}",
    ]  # fmt: skip
    return format_cells(cells)


def _find_range(scene: Scene) -> Range:
    return find_depth_range(scene.rig, scene.frame, Silent())


def select_cameras(scene: Scene, auxiliaries: Sequence[str]) -> Scene:
    """Return the scene as the core and these auxiliaries see it; `occluded` stays that of all cameras."""
    names = (scene.rig.core, *auxiliaries)
    rig = Rig(
        scene.rig.core,
        {name: scene.rig.cameras[name] for name in names},
        {name: scene.rig.cam_from_core[name] for name in names},
    )
    return replace(
        scene, rig=rig, frame=FrameSet(scene.frame.frame, {n: scene.frame.images[n] for n in names})
    )


def _volume(loaded: Scene, result: Result, empty: Result) -> tuple[float, float]:
    """Return the relative error of the heap's volume and its relative σ."""
    if loaded.true_volume_mm3 is None:
        raise ValueError(f"the scene {loaded.name} has no true volume")
    camera = loaded.rig.core_camera
    volume = measure_volume(
        result.depth,
        find_belt(empty.depth, camera),
        camera,
        VolumeSettings(),
        across_mm=None,
        along_mm=loaded.along_mm,
    )
    return volume.volume_mm3 / loaded.true_volume_mm3 - 1, volume.sigma_mm3 / loaded.true_volume_mm3
