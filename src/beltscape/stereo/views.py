"""Which cameras of a rig one frame can be measured with."""

from __future__ import annotations

from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.rig import Rig


def known_auxiliaries(rig: Rig, wanted: tuple[str, ...] | None) -> tuple[str, ...]:
    """The wanted auxiliaries, all of the rig by default, or ReconstructionError when one is not in it."""
    for name in wanted or ():
        if name not in rig.auxiliaries:
            raise ReconstructionError(
                f"{name} is no auxiliary camera of the rig; there are {', '.join(rig.auxiliaries)}"
            )
    return rig.auxiliaries if wanted is None else wanted


def usable_auxiliaries(
    rig: Rig, frame_set: FrameSet, wanted: tuple[str, ...] | None = None
) -> tuple[str, ...]:
    """The auxiliaries that have an image in this frame, or ReconstructionError when no pair is left."""
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
    return usable
