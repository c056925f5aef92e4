"""Diagnosis of the cameras of a frame: exchanged or mirrored images, moved or unmatched cameras."""

from __future__ import annotations

from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.stereo.consistency.diagnosis.exchange import find_exchange
from beltscape.stereo.consistency.diagnosis.fault_texts import CameraFault, MisplacedImages, list_faults
from beltscape.stereo.consistency.diagnosis.fitting_points import FittingPoints
from beltscape.stereo.consistency.diagnosis.mirroring import find_mirroring
from beltscape.stereo.consistency.rig_consistency import RigConsistency


def diagnose_cameras(frame_set: FrameSet, rig: Rig, consistency: RigConsistency) -> list[CameraFault]:
    """Return the faults that explain the inconsistencies of a frame; none for a sound rig."""
    return list_faults(consistency, rig, find_misplaced_images(frame_set, rig, consistency))


def find_misplaced_images(frame_set: FrameSet, rig: Rig, consistency: RigConsistency) -> MisplacedImages:
    """Return the images that fit the rig when they are exchanged, or else flipped."""
    if consistency.is_sound and consistency.find_auxiliaries("sound"):
        return MisplacedImages()
    fitting = FittingPoints(frame_set, rig)
    exchanged = find_exchange(fitting, consistency)
    return MisplacedImages(exchanged, None if exchanged else find_mirroring(fitting, consistency))
