"""Diagnosis of the cameras of a frame: exchanged, mirrored or other instants' images, moved or unmatched cameras."""

from __future__ import annotations

from dataclasses import replace

from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.stereo.consistency.diagnosis.exchange import find_exchange
from beltscape.stereo.consistency.diagnosis.fault_texts import CameraFault, FaultCauses, list_faults
from beltscape.stereo.consistency.diagnosis.fitting_points import FittingPoints
from beltscape.stereo.consistency.diagnosis.instants import find_other_instant
from beltscape.stereo.consistency.diagnosis.mirroring import find_mirroring
from beltscape.stereo.consistency.diagnosis.wrong_quantity import find_wrong_quantities
from beltscape.stereo.consistency.rig_consistency import RigConsistency


def diagnose_cameras(frame_set: FrameSet, rig: Rig, consistency: RigConsistency) -> list[CameraFault]:
    """Return the faults that explain the inconsistencies of a frame; none for a sound rig."""
    causes = add_instant(find_causes(frame_set, rig, consistency), frame_set, rig, consistency, None)
    return list_faults(consistency, rig, causes)


def find_causes(frame_set: FrameSet, rig: Rig, consistency: RigConsistency) -> FaultCauses:
    """Return what explains a frame: images that are exchanged, or flipped, or a wrong quantity of the rig."""
    if consistency.is_sound and consistency.find_auxiliaries("sound", "undecided"):
        return FaultCauses()
    fitting = FittingPoints(frame_set, rig)
    exchanged = find_exchange(fitting, consistency)
    if exchanged is not None:
        return FaultCauses(exchanged)
    mirroring = find_mirroring(fitting, consistency)
    quantities = () if mirroring else find_wrong_quantities(consistency, rig)
    return FaultCauses(mirroring=mirroring, quantities=quantities)


def add_instant(
    causes: FaultCauses, frame_set: FrameSet, rig: Rig, consistency: RigConsistency, previous: FrameSet | None
) -> FaultCauses:
    """Return the causes with a camera whose images are of another instant, if nothing else explains the frame."""
    is_open = bool(consistency.inconsistent or consistency.find_auxiliaries("undecided"))
    if not is_open or causes.exchanged or causes.mirroring or causes.quantities:
        return causes
    return replace(causes, instant=find_other_instant(FittingPoints(frame_set, rig), consistency, previous))
