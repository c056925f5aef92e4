"""The monitors of a run's images, with what earlier runs of the same system learned."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.files.exposures_csv import FILE as EXPOSURES
from beltscape.files.json_text import hash_file
from beltscape.health.images.belt_images import BeltImageMonitor
from beltscape.health.images.monitor import ImageMonitor
from beltscape.measure.belt.reference import EmptyBeltReference
from beltscape.pipeline.live import learned_images
from beltscape.pipeline.live.learned_images import LearnedImages
from beltscape.pipeline.live.project import Project, RunSettings

Monitors = tuple[ImageMonitor, BeltImageMonitor, LearnedImages]
"""The monitor of the images by themselves, that of the images against the measured belt, and what both learn."""


def make_image_monitors(
    project: Project[RunSettings],
    rig: Rig,
    empty_belt: EmptyBeltReference,
    belt_sha256: str,
    reporter: Reporter,
    data: Path | None,
) -> Monitors:
    """Return the monitors; ``data`` is the folder of what is learned, None: nothing is read or kept."""
    health = project.settings.health
    if data is None or not health.learning:
        return ImageMonitor(rig, health), BeltImageMonitor(rig, empty_belt, health), LearnedImages()
    key = {
        "rig": hash_file(project.resolve(project.settings.rig)),
        "empty belt": belt_sha256,
        "image width": rig.core_camera.size_px[0],
        **_describe_exposure(project),
    }
    path = data / learned_images.REFERENCES_FILE
    learned = learned_images.read_references(path, key, reporter)
    if learned is not None and not set(rig.cameras) <= set(learned.reference.cameras):
        learned = None  # a camera was missing when they were learned
    keep = learned_images.make_references_keeper(path, key, reporter)
    pattern_path = data / learned_images.PATTERN_FILE
    pattern = learned_images.read_pattern(pattern_path, key, reporter)
    keep_pattern = learned_images.make_pattern_keeper(pattern_path, key, reporter)
    images = ImageMonitor(rig, health, learned, keep)
    belt_images = BeltImageMonitor(rig, empty_belt, health, pattern, keep_pattern)
    return images, belt_images, LearnedImages((images, belt_images), (path, pattern_path))


def _describe_exposure(project: Project[RunSettings]) -> dict[str, Any]:
    """Return what makes the levels of images comparable beside their stated exposure times."""
    cameras, capture = project.settings.cameras, project.settings.capture
    if cameras is None:
        is_stated = capture is not None and (project.resolve(capture.folder) / EXPOSURES).is_file()
        return {"stated exposure": is_stated}
    gains = {name: cameras.gain_of(name) for name in cameras.devices}
    return {"stated exposure": bool(cameras.exposures_us), "gain": gains}
