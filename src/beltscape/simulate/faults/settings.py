"""All faults of a scenario: the table [faults] of its file."""

from __future__ import annotations

from collections.abc import Iterator

from pydantic import BaseModel, ConfigDict

from beltscape.simulate.faults.base import Fault
from beltscape.simulate.faults.belt import CarryBack, ForeignObject, MovedBelt, RunningOff, Splice, TornEdge
from beltscape.simulate.faults.cameras import MovedCamera, MovedRig, Vibration
from beltscape.simulate.faults.delivery import (
    ExchangedCameras,
    LateCamera,
    MirroredImages,
    MissingFrames,
    RepeatedImages,
)
from beltscape.simulate.faults.encoder import EncoderFault
from beltscape.simulate.faults.exposure import OverExposure
from beltscape.simulate.faults.haze import Condensation, Defocus, Dust
from beltscape.simulate.faults.lighting import Flicker, ProjectorFault, Sunlight
from beltscape.simulate.faults.obstruction import Dirt, LensCap


class Faults(BaseModel):
    """Faults of the plant."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    dead_projector: bool = False
    projector: tuple[ProjectorFault, ...] = ()
    sunlight: tuple[Sunlight, ...] = ()
    flicker: tuple[Flicker, ...] = ()
    dirt: tuple[Dirt, ...] = ()
    lens_cap: tuple[LensCap, ...] = ()
    condensation: tuple[Condensation, ...] = ()
    dust: tuple[Dust, ...] = ()
    defocus: tuple[Defocus, ...] = ()
    over_exposure: tuple[OverExposure, ...] = ()
    moved_camera: tuple[MovedCamera, ...] = ()
    vibration: tuple[Vibration, ...] = ()
    moved_rig: tuple[MovedRig, ...] = ()
    missing_frames: tuple[MissingFrames, ...] = ()
    repeated_images: tuple[RepeatedImages, ...] = ()
    late_camera: tuple[LateCamera, ...] = ()
    exchanged_cameras: tuple[ExchangedCameras, ...] = ()
    mirrored_images: tuple[MirroredImages, ...] = ()
    moved_belt: tuple[MovedBelt, ...] = ()
    running_off: tuple[RunningOff, ...] = ()
    carry_back: tuple[CarryBack, ...] = ()
    splice: tuple[Splice, ...] = ()
    torn_edge: tuple[TornEdge, ...] = ()
    foreign_object: tuple[ForeignObject, ...] = ()
    encoder: tuple[EncoderFault, ...] = ()

    def list_faults(self) -> Iterator[tuple[str, Fault]]:
        """Yield every fault with the name of its list."""
        for name in type(self).model_fields:
            value: bool | tuple[Fault, ...] = getattr(self, name)
            if not isinstance(value, bool):
                yield from ((name, fault) for fault in value)

    def list_cameras(self) -> Iterator[tuple[str, str]]:
        """Yield the name of the list and of the camera for every camera that a fault names."""
        for name, fault in self.list_faults():
            cameras = [getattr(fault, "camera", ""), *getattr(fault, "cameras", ())]
            yield from ((name, camera) for camera in cameras if camera)
