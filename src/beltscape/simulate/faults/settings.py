"""All faults of a scenario: the table [faults] of its file.

Those of light and image are applied to the images of any capture, without rendering it again.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from zlib import crc32

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from beltscape.core.frames import FrameSet, Image
from beltscape.core.geometry.camera import Camera
from beltscape.simulate.faults.base import Fault
from beltscape.simulate.faults.belt import CarryBack, ForeignObject, MovedBelt, RunningOff, Splice, TornEdge
from beltscape.simulate.faults.cameras import MovedCamera, MovedRig, Vibration, displace_image
from beltscape.simulate.faults.delivery import (
    EncoderFault,
    ExchangedCameras,
    LateCamera,
    MirroredImages,
    MissingFrames,
    RepeatedImages,
)
from beltscape.simulate.faults.lighting import Flicker, OverExposure, ProjectorFault, Sunlight
from beltscape.simulate.faults.obstruction import Condensation, Defocus, Dirt, Dust, LensCap


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


_READ_NOISE = 0.5
"""σ of the read noise that is added to a changed image, in its values: dimming and blurring remove noise."""


def apply_to_images(
    frames: FrameSet, faults: Faults, frame: int, cameras: Mapping[str, Camera], distance_mm: float
) -> FrameSet:
    """Return a frame set as the faulty plant would deliver it.

    Faults of the delivery (missing, repeated and late images) need other frames and are the caller's; those of belt
    and rig, and a moved projector, need a rendering.

    Parameters
    ----------
    frames
        Of the sound plant.
    faults
        The faults.
    frame
        Number of the frame.
    cameras
        Intrinsics at the size of the images, for moved cameras.
    distance_mm
        From the cameras to the belt, for shifted cameras.
    """
    images = {
        name: degrade_image(image, faults, name, frame, (frames.time_ns or 0) * 1e-9)
        for name, image in frames.images.items()
    }
    images = {
        name: _displace(image, faults, frame, cameras[name], distance_mm) for name, image in images.items()
    }
    return replace(frames, images=rearrange_images(images, faults, frame))


def degrade_image(image: Image, faults: Faults, camera: str, frame: int, time_s: float) -> Image:
    """Return a camera's image with the faults of its light, window, lens and exposure; the same bytes without any."""
    top = 65535 if image.dtype == np.uint16 else 255
    light = image.astype(np.float32) / np.float32(top)
    changed = degrade_light(light, faults, camera, frame, time_s)
    for fault in faults.projector:
        changed = fault.apply_to_image(changed, frame)
    for fault in faults.over_exposure:
        changed = fault.apply_to_image(changed, frame) if fault.camera == camera else changed
    if changed is light:
        return image
    rng = np.random.default_rng([crc32(camera.encode()), frame])
    noise = _READ_NOISE * rng.standard_normal(changed.shape, dtype=np.float32)
    return np.clip(np.rint(changed * top + noise), 0, top).astype(image.dtype)


def degrade_light(
    light: NDArray[np.float32], faults: Faults, camera: str, frame: int, time_s: float
) -> NDArray[np.float32]:
    """Return the light on a camera's sensor, (H, W) or (H, W, 3), behind sun, lamps, air, window and lens."""
    for sunlight in faults.sunlight:
        light = sunlight.apply(light, frame) if sunlight.camera in ("", camera) else light
    for flicker in faults.flicker:
        light = flicker.apply(light, frame, time_s) if flicker.camera in ("", camera) else light
    for dust in faults.dust:
        light = dust.apply(light, frame) if dust.is_active(frame) and dust.camera in ("", camera) else light
    for fault in (*faults.condensation, *faults.dirt, *faults.lens_cap, *faults.defocus):
        light = fault.apply(light, frame) if fault.camera == camera else light
    return light


def rearrange_images(images: Mapping[str, Image], faults: Faults, frame: int) -> dict[str, Image]:
    """Return the images by camera with those of exchanged cameras exchanged, and mirrored ones mirrored."""
    rearranged = dict(images)
    for fault in faults.mirrored_images:
        if fault.is_active(frame) and fault.camera in rearranged:
            flipped = rearranged[fault.camera]
            flipped = flipped[::-1] if fault.vertically else flipped[:, ::-1]
            rearranged[fault.camera] = np.ascontiguousarray(flipped)
    for fault in faults.exchanged_cameras:
        first, second = fault.cameras
        if fault.is_active(frame):
            sources = {first: rearranged.pop(second, None), second: rearranged.pop(first, None)}
            rearranged.update({name: image for name, image in sources.items() if image is not None})
    return rearranged


def _displace(image: Image, faults: Faults, frame: int, camera: Camera, distance_mm: float) -> Image:
    for moved in faults.moved_camera:
        if moved.camera == camera.name and moved.is_active(frame):
            image = displace_image(image, camera, moved.displacement, distance_mm)
    for vibration in faults.vibration:
        if vibration.camera == camera.name and vibration.is_active(frame):
            image = displace_image(image, camera, vibration.displacement_at(frame), distance_mm)
    return image
