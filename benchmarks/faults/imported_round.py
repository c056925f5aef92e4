"""A round rendered by another program, brought into the form of the bench's own captures.

Rows whose images must be rendered anew are not played on it, but for foreign objects, which are drawn into its
images; a zero that was learned wrong is that of its empty belt, displaced.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from beltscape.core.frames import Image
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import scale_rig
from beltscape.core.progress import Reporter
from beltscape.files.belt_json import write_belt
from beltscape.files.images import read_image, write_image
from beltscape.files.json_text import read_json, write_json
from beltscape.files.rig_json import write_rig
from beltscape.pipeline.measuring.belt import read_empty_belt
from beltscape.simulate.faults.settings import Faults
from beltscape.simulate.world import Station
from captures import parse_true_rig
from faults.capture import FRAMES_PER_S, RoundCapture, Sizes
from faults.case import Case
from faults.drawn_object import draw_objects, read_projector

IMPORTED = "imported"
"""Name of its folder in the cache."""
_STEP_MM = 200.0
"""Belt between the last frame, in which it is empty, and the first of the next round: as much as between others."""


@dataclass(frozen=True)
class ImportedRound(RoundCapture):
    """A round whose plant cannot be rendered anew."""

    rendered: Path = Path()
    """The folder of captures that it is from."""

    def learn_zero(self, name: str, faults: Mapping[str, Any], reporter: Reporter) -> Path:
        """Return the belt.json of the empty belt, displaced as it was with these faults when the zero was learned."""
        belt, camera = read_empty_belt(self.folder / "empty_rec", reporter)
        for fault in Faults.model_validate(faults).moved_belt:
            belt = replace(belt, belt_from_core=fault.pose_at(0).inverse() @ belt.belt_from_core)
        path = self.folder / f"{name}.json"
        write_belt(path, belt, camera)
        return path

    def make_renderer(
        self, cameras: Sequence[str], faults: Mapping[str, Any]
    ) -> Callable[[int], Mapping[str, Image]]:
        """Return what draws the foreign objects of these faults into a frame."""
        del cameras  # all are drawn
        core = read_json(self.rendered / "truth" / "rig.json")["cameras"][self.rig.core]
        station = Station(self.rig, Pose.of(core["R"], core["t"]))
        objects, projector = Faults.model_validate(faults).foreign_object, read_projector(self.rendered)
        return lambda frame: draw_objects(self.images(frame).images, station, projector, objects, frame)


def is_playable(case: Case) -> bool:
    """Return whether a row needs no images of another plant, or of the same with other faults."""
    return (not case.rendered or set(case.faults) == {"foreign_object"}) and case.belt_width_mm is None


def import_round(rendered: Path, cache: Path, reporter: Reporter) -> ImportedRound:
    """Return the moving belt of the folder of rendered captures, converted into a cache folder once."""
    frames = read_json(rendered / "truth" / "belt_moving.json")["frames"]
    out = cache / IMPORTED
    capture = ImportedRound(out, Sizes(IMPORTED, len(frames), 0.25, 0), seed=0, rendered=rendered)
    if not (out / "moving" / "truth" / "belt_moving.json").is_file():
        _write_moving(rendered, out / "moving", frames)
    if not (out / "empty_rec" / "reconstruction.json").is_file():
        _reconstruct_empty_belt(rendered, capture, reporter)
    return capture


def _write_moving(rendered: Path, out: Path, frames: list[dict[str, Any]]) -> None:
    truth = read_json(rendered / "truth" / "rig.json")
    rig = scale_rig(parse_true_rig(truth), 0.5)
    for camera in rig.cameras:
        shutil.copytree(rendered / "belt_moving" / camera, out / camera, dirs_exist_ok=True)
    (out / "truth").mkdir(exist_ok=True)
    write_rig(out / "truth" / "rig.json", rig)
    with np.load(rendered / "truth" / "belt_moving_profile.npz") as profile:
        y_mm = profile["y_belt_first"] + profile["step"] * np.arange(len(profile["area_mm2"]))
        np.savez(out / "truth" / "belt_moving_load.npz", y_mm=y_mm, area_mm2=profile["area_mm2"])
    core = truth["cameras"][rig.core]
    height_mm = float(Pose.of(core["R"], core["t"]).inverse().translation_mm[2])
    write_json(out / "truth" / "scenario.json", {"kind": "belt_moving", "rig": {"height_mm": height_mm}})
    shutil.copyfile(rendered / "belt_moving" / "encoder.csv", out / "encoder.csv")
    positions = [float(one["belt_position_mm"]) for one in frames]
    round_mm = positions[-1] - positions[0] + _STEP_MM
    listed = [
        {"frame": Path(one["frame"]).stem, "belt_position_mm": position - positions[0]}
        for one, position in zip(frames, positions, strict=True)
    ]
    speed = round_mm / len(frames) * FRAMES_PER_S
    write_json(out / "truth" / "belt_moving.json", {"speed_mm_s": speed, "frames": listed})


def _reconstruct_empty_belt(rendered: Path, capture: ImportedRound, reporter: Reporter) -> None:
    """Reconstruct the empty belt from its images, reduced to the size of those of the moving one."""
    from beltscape.pipeline.reconstructing.reconstruction import reconstruct_capture

    images = capture.folder / "empty_rec_images"
    for camera in capture.rig.cameras:
        whole = read_image(rendered / "belt_empty" / camera / "000.png")
        half = cv2.resize(whole, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        write_image(images / camera / "000.png", half)
    reconstruct_capture(images, capture.rig, capture.folder / "empty_rec", reporter)
