"""A simulated scene: the objects of a scenario in every frame, and the images that the cameras take of them.

As a frame source it yields frame sets one after another, as many as requested.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from itertools import count
from pathlib import Path

import numpy as np

from beltscape.core.errors import InputError
from beltscape.core.frames import FrameSet, Image
from beltscape.core.geometry.pose import Pose
from beltscape.simulate.faults.belt import join_notches, move_solids
from beltscape.simulate.faults.settings import Faults, degrade_light, rearrange_images
from beltscape.simulate.rendering.render import RenderSettings, render, render_exposure, sample_exposure
from beltscape.simulate.rendering.sensor import Sensor, expose, make_noise_seed
from beltscape.simulate.rig_and_projector import make_projector, make_station, sample_board_poses
from beltscape.simulate.scenario import Scenario
from beltscape.simulate.solids.belt import make_belt_solids
from beltscape.simulate.solids.board import make_board_solid, make_module_solids, place_module
from beltscape.simulate.solids.heap import Heap, make_heap, shift_solids
from beltscape.simulate.world import Projector, Solid, Station, World
from beltscape.target.board import read_board
from beltscape.target.board_set import BoardSet
from beltscape.target.module import Module, read_module
from beltscape.target.planar_boards import AprilGrid, SquareBoard

BOARD_VIEWS = 24
"""Default number of views of a calibration board."""
MAX_FRAMES = 100_000
"""Maximum number of frames, as for `Scenario.frames`."""
EXPOSURE_QUANTILE, EXPOSURE_SHARE = 0.998, 0.85
"""Auto exposure puts this quantile of the core's first image at this share of the full well."""


@dataclass(frozen=True)
class SimulatedScene:
    """A scenario with its objects, each made on first use; the same scenario gives the same objects."""

    scenario: Scenario

    @cached_property
    def station(self) -> Station:
        """Return the rig as it was calibrated: the truth."""
        return make_station(self.scenario.rig)

    def station_at(self, frame: float) -> Station:
        """Return the rig at the time of a frame, with the moved cameras at their new poses."""
        current, faults = self.station, self.scenario.faults
        if self.scenario.kind != "calibration":
            for fault in (*faults.moved_camera, *faults.vibration, *faults.moved_rig):
                current = fault.apply(current, int(frame))
        return current

    @cached_property
    def projector(self) -> Projector | None:
        """Return the projector; None where it is off."""
        return make_projector(self.scenario.projector) if self.scenario.is_lit else None

    @cached_property
    def belt(self) -> tuple[Solid, Solid]:
        """Return belt and floor."""
        return make_belt_solids(self.scenario.belt)

    @cached_property
    def heap(self) -> Heap | None:
        """Return the heap of a loaded belt; it is the same on the still and on the moving belt."""
        has_heap = self.scenario.kind in ("belt_loaded", "belt_moving")
        settings = self.scenario.heap
        seeded = settings.model_copy(update={"seed": settings.seed + self.scenario.seed})
        return make_heap(seeded, self.scenario.belt) if has_heap else None

    @cached_property
    def module(self) -> Module | None:
        """Return the module of a scene with a module."""
        return read_module(self.module_file) if self.scenario.kind == "module" else None

    @property
    def module_file(self) -> Path:
        """Return the path of module.toml."""
        return self.scenario.module.file or Path(str(files("beltscape") / "data" / "module.toml"))

    @cached_property
    def world_from_module(self) -> Pose | None:
        """Return the pose of the module."""
        spec = self.scenario.module
        return place_module(self.module, spec.x_mm, spec.y_mm, spec.turn_deg) if self.module else None

    @cached_property
    def board(self) -> SquareBoard | None:
        """Return the board of a calibration; InputError unless it is a chessboard or a ChArUco board."""
        file = self.scenario.board.file or Path(str(files("beltscape") / "data" / "board.toml"))
        if self.scenario.kind != "calibration":
            return None
        board = read_board(file)
        if isinstance(board, AprilGrid | BoardSet):
            raise InputError(f"{file}: {board.describe()}: only one ChArUco board or chessboard is simulated")
        return board

    @cached_property
    def world_from_board(self) -> tuple[Pose, ...]:
        """Return the board's poses by frame; after the last the first follows again. Empty without a board."""
        if self.board is None:
            return ()
        seed = self.scenario.seed
        return sample_board_poses(self.scenario.board, self.board, self.station, self.frame_count, seed)

    def frame_name(self, frame: int) -> str:
        """Return the name of a frame."""
        return f"{frame:03d}"

    def frame_seed(self, frame: int) -> int:
        """Return the seed of a frame's rendering."""
        return self.scenario.seed * 100_003 + frame

    def time_s(self, frame: float) -> float:
        """Return the time at which a frame is taken."""
        return frame / self.scenario.motion.frames_per_s

    def belt_position_mm(self, frame: float) -> float:
        """Return the travel of the belt towards +y since the first frame."""
        return self.scenario.motion.speed_mm_s * self.time_s(frame) if self._moves else 0.0

    def heap_position_mm(self, frame: float) -> float:
        """Return the position of the heap's centre; once out of view it enters again."""
        if not self._moves:
            return 0.0
        start, far = self.scenario.motion.start_mm, self._far_mm
        direction = 1 if self.scenario.motion.speed_mm_s >= 0 else -1
        first = -far if start is None else direction * start
        return float(direction * ((first + direction * self.belt_position_mm(frame) + far) % (2 * far) - far))

    @cached_property
    def frame_count(self) -> int:
        """Return the number of frames of a capture; InputError where the heap takes too many to pass."""
        if self.scenario.frames is not None:
            return self.scenario.frames
        if self.scenario.kind == "calibration":
            return BOARD_VIEWS
        step = abs(self.scenario.motion.speed_mm_s) / self.scenario.motion.frames_per_s
        if not self._moves or step == 0:
            return 1
        if 2 * self._far_mm > MAX_FRAMES * step:
            raise InputError(
                f"motion.speed_mm_s = {self.scenario.motion.speed_mm_s:g}: the heap takes more than "
                f"{MAX_FRAMES} frames to pass; give the number of frames with frames"
            )
        return int(np.ceil(2 * self._far_mm / step))

    def world_at(self, frame: float) -> World:
        """Return the world at the time of a frame, or at an instant between frames."""
        world = World(self._solids_at(frame), self.projector, self.scenario.ambient)
        for fault in self.scenario.faults.projector:
            world = fault.apply(world, int(frame))
        return world

    def render_frame(self, frame: int) -> FrameSet:
        """Return the images of a frame, without those of cameras that do not deliver it."""
        images: dict[str, Image] = {}
        for (source, late_frames), cameras in self._group_by_instant(frame).items():
            light = self._render_light(source, late_frames, cameras)
            images |= {name: self._expose(name, source, light[name]) for name in cameras}
        images = {name: images[name] for name in self.delivering_cameras(frame)}
        images = rearrange_images(images, self.scenario.faults, frame)
        return FrameSet(self.frame_name(frame), images, time_ns=round(self.time_s(frame) * 1e9))

    def delivering_cameras(self, frame: int) -> list[str]:
        """Return the cameras that deliver a frame."""
        faults = self.scenario.faults.missing_frames
        return [
            name for name in self.station.rig.cameras if all(fault.delivers(name, frame) for fault in faults)
        ]

    def _group_by_instant(self, frame: int) -> dict[tuple[int, float], list[str]]:
        """Return the delivering cameras by the frame that they show and the lateness of their exposure in frames."""
        groups: dict[tuple[int, float], list[str]] = {}
        faults, rate = self.scenario.faults, self.scenario.motion.frames_per_s
        for name in self.delivering_cameras(frame):
            source, late_frames = frame, 0.0
            for repeated in faults.repeated_images:
                source = repeated.source_frame(source) if repeated.camera in ("", name) else source
            for late in faults.late_camera:
                if late.camera == name and late.is_active(frame):
                    source, late_frames = late.source_frame(source), late_frames + late.late_ms * 1e-3 * rate
            groups.setdefault((source, late_frames), []).append(name)
        return groups

    @property
    def _moves(self) -> bool:
        return self.scenario.kind == "belt_moving"

    @cached_property
    def _far_mm(self) -> float:
        """Return the distance of the heap's centre at which it comes again.

        The end of its fines has left the core's view of the level middle then, and half of the gap.
        """
        camera = self.station.rig.core_camera
        view = camera.size_px[1] / 2 / camera.focal_px[1] * self.station.core_from_world.center_mm[2]
        fines = max(abs(end) for end in self.scenario.heap.fines.along_mm)
        return float(fines + view + self.scenario.motion.gap_mm / 2)

    def _solids_at(self, frame: float) -> tuple[Solid, ...]:
        if self.board is not None:  # the calibration takes place without the belt
            pose = self.world_from_board[int(frame) % self.frame_count]
            return (self.belt[1], make_board_solid(self.board, pose))
        solids = (*self._belt_at(frame), *self._layers_at(frame), *self._load_at(frame))
        for fault in self.scenario.faults.moved_belt:
            solids = move_solids(solids, fault.pose_at(frame)) if fault.is_active(frame) else solids
        objects = (fault.make_solid(frame) for fault in self.scenario.faults.foreign_object)
        return (*solids, *(one for one in objects if one is not None))

    def _belt_at(self, frame: float) -> tuple[Solid, Solid]:
        """Return belt and floor in a frame."""
        faults = [fault for fault in self.scenario.faults.running_off if fault.is_active(frame)]
        torn = [fault for fault in self.scenario.faults.torn_edge if fault.is_active(frame)]
        if not faults and not torn:
            return self.belt
        settings = self.scenario.belt
        for fault in faults:
            settings = fault.apply(settings, frame)
        travel = self.belt_position_mm(frame) if self._moves else 0.0
        notches = [fault.make_notches(settings, travel, frame) for fault in torn]
        return make_belt_solids(settings, join_notches(notches) if notches else None)

    def _layers_at(self, frame: float) -> tuple[Solid, ...]:
        """Return what sticks to the belt and comes round with it: carry-back and splices."""
        faults, belt = self.scenario.faults, self.scenario.belt
        made = [fault.make_solid(belt, frame) for fault in (*faults.carry_back, *faults.splice)]
        layers = tuple(solid for solid in made if solid is not None)
        if not self._moves or not layers:
            return layers
        length = belt.length_mm  # one copy enters where the other leaves
        along = self.belt_position_mm(frame) % length
        return (*shift_solids(layers, along), *shift_solids(layers, along - length))

    def _load_at(self, frame: float) -> tuple[Solid, ...]:
        if self.module is not None and self.world_from_module is not None:
            reflectance = self.scenario.module.reflectance
            return tuple(make_module_solids(self.module, self.world_from_module, reflectance))
        return () if self.heap is None else shift_solids(self.heap.solids, self.heap_position_mm(frame))

    def _render_light(self, frame: int, late_frames: float, names: list[str]) -> dict[str, np.ndarray]:
        scenario, world = self.scenario, self.world_at(frame + late_frames)
        station, optics = self.station_at(frame), dict.fromkeys(names, scenario.optics)
        seed = self.frame_seed(frame)
        travel = scenario.motion.speed_mm_s * scenario.motion.exposure_us * 1e-6 if self._moves else 0.0
        if travel:
            worlds = sample_exposure(world, station, travel)
            light = render_exposure(worlds, station, optics, scenario.render, seed=seed)
        else:
            light = render(world, station, optics, scenario.render, seed=seed)
        time_s = self.time_s(frame)
        return {name: degrade_light(one, scenario.faults, name, frame, time_s) for name, one in light.items()}

    def _expose(self, name: str, frame: int, light: np.ndarray) -> Image:
        # not the amplifier's gain: with a smaller gain a saturated pixel would not reach the largest value
        electrons = self._sensor.electrons_at_1 * self._sensitivity[name]
        sensor = self._sensor.model_copy(update={"electrons_at_1": electrons})
        for fault in self.scenario.faults.over_exposure:
            sensor = fault.apply(sensor, frame) if fault.camera == name else sensor
        return expose(light, sensor, make_noise_seed(self.scenario.seed, name, self.frame_name(frame)))

    @cached_property
    def _sensitivity(self) -> dict[str, float]:
        rng, spread = np.random.default_rng([self.scenario.rig.seed, 2]), self.scenario.gain_spread
        return {name: float(rng.uniform(1 - spread, 1 + spread)) for name in self.station.rig.cameras}

    @cached_property
    def _sensor(self) -> Sensor:
        """Return the sensor with colour and exposure chosen where the scenario leaves them open."""
        scenario, sensor = self.scenario, self.scenario.sensor
        colour = scenario.colour if scenario.colour is not None else scenario.is_lit
        if colour and sensor.colour == "grey":
            sensor = sensor.model_copy(update={"colour": "rgb"})
        if not scenario.auto_exposure:
            return sensor
        core = self.station.rig.core
        sampling = RenderSettings(oversample=1, passes=1, ambient_samples=1, engine=scenario.render.engine)
        middle = self._brightest_frame
        # it was set before a fault began
        calm = scenario.model_copy(update={"faults": Faults()})
        before = self if scenario == calm else SimulatedScene(calm)
        world = World(before._solids_at(middle), self.projector, scenario.ambient)
        light = render(world, self.station, {core: scenario.optics}, sampling, seed=scenario.seed)[core]
        irradiance = light.mean(axis=-1) if sensor.colour == "grey" else light
        bright = max(float(np.quantile(irradiance, EXPOSURE_QUANTILE)), 1e-6)
        return sensor.model_copy(
            update={"electrons_at_1": EXPOSURE_SHARE * sensor.full_well_e / bright / sensor.gain}
        )

    @property
    def _brightest_frame(self) -> int:
        """Return the first frame, or on a moving belt the one with the heap nearest to the rig."""
        if not self._moves:
            return 0
        return min(range(min(self.frame_count, 10_000)), key=lambda i: abs(self.heap_position_mm(i)))


class SimulatedSource:
    """A `FrameSource` of a scenario; endless unless the number of frames is given.

    On a moving belt the heap passes again and again, with a piece of empty belt in between; a calibration repeats the
    poses of its board.
    """

    def __init__(self, scenario: Scenario, *, frames: int | None = None) -> None:
        self.scene = SimulatedScene(scenario)
        self._frames = frames

    @property
    def cameras(self) -> tuple[str, ...]:
        """Return the names of the cameras."""
        return tuple(self.scene.station.rig.cameras)

    def __len__(self) -> int:
        return sys.maxsize if self._frames is None else self._frames

    def __iter__(self) -> Iterator[FrameSet]:
        for frame in count() if self._frames is None else range(self._frames):
            yield self.scene.render_frame(frame)
