"""The capture that the bench plays: one round of a heap on a moving belt, which repeats without a seam."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.core.frames import FrameSet, Image
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.files.images import read_image, write_image
from beltscape.files.json_text import read_json
from beltscape.files.rig_json import read_rig
from beltscape.pipeline.simulation import simulate
from beltscape.simulate.faults.settings import Faults
from beltscape.simulate.scenario import Scenario
from beltscape.simulate.scene_assembly import SimulatedScene

FRAMES_PER_S = 8.0
_GAP_MM = 300.0
"""Belt between two heaps beyond their fines, so that all rocks of one have left the view when it comes again."""
_PLATE_MM = 15.0
"""Depth of the cover plate below the middle of a belt whose edges are in view: within the range that is measured."""


@dataclass(frozen=True)
class Sizes:
    """How large the capture is."""

    name: str
    frames: int
    """Of one round."""
    scale: float
    """Of the images to the sensor of 2448 × 2048 pixels."""
    passes: int
    """Sets of sub-samples of the rendering."""


LONG = Sizes("long", 20, 0.25, 1)
SHORT = Sizes("short", 20, 0.125, 1)


@dataclass(frozen=True)
class RoundCapture:
    """A rendered round with its truth."""

    folder: Path
    """Holds ``moving`` and ``empty_rec``, the reconstruction of the empty belt."""
    sizes: Sizes
    seed: int
    belt_width_mm: float | None = None
    """Of a belt narrower than the view; None: the simulator's."""

    @cached_property
    def rig(self) -> Rig:
        """Return the true rig."""
        return read_rig(self.folder / "moving" / "truth" / "rig.json")

    @cached_property
    def truth(self) -> dict[str, Any]:
        """Return belt_moving.json."""
        return read_json(self.folder / "moving" / "truth" / "belt_moving.json")

    @cached_property
    def frames(self) -> int:
        """Return the number of frames of the round."""
        return len(self.truth["frames"])

    @cached_property
    def round_mm(self) -> float:
        """Return the travel of the belt over the round."""
        return float(self.truth["speed_mm_s"]) / FRAMES_PER_S * self.frames

    @cached_property
    def positions_mm(self) -> np.ndarray:
        """Return (N,) the true position of the belt in each frame of the first round."""
        return np.array([float(frame["belt_position_mm"]) for frame in self.truth["frames"]])

    def position_mm(self, frame: int) -> float:
        """Return the true position in a frame of the endless belt."""
        rounds, index = divmod(frame, self.frames)
        return rounds * self.round_mm + float(self.positions_mm[index])

    @cached_property
    def scenario(self) -> Scenario:
        """Return the scene as it was rendered."""
        return Scenario.model_validate(read_json(self.folder / "moving" / "truth" / "scenario.json"))

    @cached_property
    def area(self) -> tuple[np.ndarray, np.ndarray]:
        """Return y (mm, on the heap) and the load's cross-section there (mm²) over one round."""
        with np.load(self.folder / "moving" / "truth" / "belt_moving_load.npz") as arrays:
            return arrays["y_mm"], arrays["area_mm2"]

    def images(self, frame: int) -> FrameSet:
        """Return the images of a frame of the endless belt, with its time and true position."""
        index = frame % self.frames
        name = self.truth["frames"][index]["frame"]
        cameras = {c: read_image(self.folder / "moving" / c / f"{name}.png") for c in self.rig.cameras}
        time_ns = round(frame / FRAMES_PER_S * 1e9)
        return FrameSet(f"{frame:05d}", cameras, time_ns, self.position_mm(frame))

    def learn_zero(self, name: str, faults: Mapping[str, Any], reporter: Reporter) -> Path:
        """Return the empty belt's reconstruction, as it was with these faults when the zero was learned."""
        from beltscape.pipeline.reconstructing.reconstruction import reconstruct_capture

        out, images = self.folder / name, self.folder / f"{name}_images"
        if not (out / "reconstruction.json").is_file():
            scene = {**_describe_plant(self), "kind": "belt_empty", "seed": self.seed + 2, "faults": faults}
            simulate(Scenario.model_validate(scene), images, reporter)
            reconstruct_capture(images, self.rig, out, reporter)
        return out

    def render(self, name: str, cameras: Sequence[str], faults: Mapping[str, Any]) -> Path:
        """Return the folder with these cameras' images of the whole round, rendered with these faults."""
        out, render = self.folder / name, self.make_renderer(cameras, faults)
        for frame, listed in enumerate(self.truth["frames"]):
            paths = {camera: out / camera / f"{listed['frame']}.png" for camera in cameras}
            if not all(path.is_file() for path in paths.values()):
                images = render(frame)
                for camera, path in paths.items():
                    write_image(path, images[camera])
        return out

    def make_renderer(
        self, cameras: Sequence[str], faults: Mapping[str, Any]
    ) -> Callable[[int], Mapping[str, Image]]:
        """Return what renders a frame of the round in these cameras with these faults."""
        others = [{"camera": other} for other in self.rig.cameras if other not in cameras]
        changed = {"faults": Faults.model_validate({**faults, "missing_frames": others})}
        scene = SimulatedScene(self.scenario.model_copy(update=changed))
        return lambda frame: scene.render_frame(frame).images


def open_capture(
    folder: Path, sizes: Sizes, seed: int, reporter: Reporter, belt_width_mm: float | None = None
) -> RoundCapture:
    """Return the capture in a cache folder; render it first where it is not there yet (minutes).

    ``belt_width_mm`` is that of a belt narrower than the view, whose marks come round with the heap; None: the
    simulator's belt, whose edges are out of view.
    """
    out = folder / (f"{sizes.name}-{seed}" + ("" if belt_width_mm is None else f"-{belt_width_mm:g}mm"))
    capture = RoundCapture(out, sizes, seed, belt_width_mm)
    plant = _describe_plant(capture)
    motion = {"frames_per_s": FRAMES_PER_S, "gap_mm": _GAP_MM}
    moving = {**plant, "kind": "belt_moving", "seed": seed + 1, "frames": sizes.frames, "motion": motion}
    if not (out / "moving" / "encoder.csv").is_file():
        speed = _choose_speed(Scenario.model_validate(moving), sizes.frames)
        if belt_width_mm is not None:
            moving["belt"] = {**plant["belt"], "length_mm": speed / FRAMES_PER_S * sizes.frames}
        moving["motion"] = {**motion, "speed_mm_s": speed}
        simulate(Scenario.model_validate(moving), out / "moving", reporter)
    capture.learn_zero("empty_rec", {}, reporter)
    return capture


def _describe_plant(capture: RoundCapture) -> dict[str, Any]:
    sizes = capture.sizes
    render = {"passes": sizes.passes, "ambient_samples": 1 if sizes.passes == 1 else 4}
    width = capture.belt_width_mm
    belt = {} if width is None else {"width_mm": width, "floor_mm": _PLATE_MM}
    return {"rig": {"seed": capture.seed, "scale": sizes.scale}, "render": render, "belt": belt}


def _choose_speed(scenario: Scenario, frames: int) -> float:
    """Return the speed at which the heap comes again after exactly this number of frames, mm/s."""
    round_mm = -2 * SimulatedScene(scenario).heap_position_mm(0)
    return round_mm / frames * FRAMES_PER_S
