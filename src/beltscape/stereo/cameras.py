"""The cameras of a rig that can measure a frame."""

from __future__ import annotations

from beltscape.core.errors import InputError, ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig


def check_auxiliaries(rig: Rig, wanted: tuple[str, ...] | None) -> tuple[str, ...]:
    """Return the wanted auxiliaries, all of the rig by default; raise ReconstructionError when one is not in it."""
    for name in wanted or ():
        if name not in rig.auxiliaries:
            raise ReconstructionError(
                f"{name} is no auxiliary camera of the rig; there are {', '.join(rig.auxiliaries)}"
            )
    return rig.auxiliaries if wanted is None else wanted


def list_usable_auxiliaries(
    rig: Rig, frame_set: FrameSet, wanted: tuple[str, ...] | None = None
) -> tuple[str, ...]:
    """Return the auxiliaries that have an image in this frame; raise ReconstructionError when there is none.

    Raises
    ------
    InputError
        When an image has another size than its camera.
    """
    unknown = [name for name in frame_set.images if name not in rig.cameras]
    if unknown:
        raise ReconstructionError(
            f"frame {frame_set.frame}: images of {', '.join(unknown)}, which the rig does not have; its cameras are "
            f"{', '.join(rig.cameras)}"
        )
    if rig.core not in frame_set.images:
        raise ReconstructionError(
            f"frame {frame_set.frame}: no usable image of the core camera {rig.core}; depth is measured in its view"
        )
    names = rig.auxiliaries if wanted is None else wanted
    usable = tuple(name for name in names if name in frame_set.images)
    if not usable:
        raise ReconstructionError(
            f"frame {frame_set.frame}: no usable image of an auxiliary camera "
            f"({', '.join(names) or 'none in the rig'}); depth needs a second view"
        )
    for name in (rig.core, *usable):
        width, height = rig.cameras[name].size_px
        shape = frame_set.images[name].shape
        if tuple(shape[:2]) != (height, width):
            raise InputError(
                f"frame {frame_set.frame}: the image of {name} has {shape[1]}×{shape[0]} px, its camera in the rig "
                f"{width}×{height}; give images of that size, or scale the rig"
            )
    return usable
