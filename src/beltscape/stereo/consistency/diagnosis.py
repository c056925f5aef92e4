"""Diagnosis of the cameras of a frame: what is wrong with them, as messages whose details are the evidence.

Images may be exchanged, mirrored or of another instant, cameras moved or unmatched. For a frame with low
coverage the most likely cause according to its images is given.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.translatable_message import make_message
from beltscape.stereo.consistency.check import LEAST_TIE_POINTS
from beltscape.stereo.consistency.rig_consistency import CameraConsistency, RigConsistency
from beltscape.stereo.consistency.wrong_images import (
    FittingPoints,
    Mirroring,
    OtherInstant,
    find_exchange,
    find_mirroring,
    find_other_instant,
)
from beltscape.stereo.consistency.wrong_quantity import WrongQuantity, find_wrong_quantities

_SMOOTH = 0.85
"""Least share of the found points that one function of place explains if a camera moved or its lens changed: 0.97
under wrong rigs of rendered rooms, 0.5 to 0.7 for images of another instant."""
_SLOPED = 2.0
"""A row error whose extremes differ by more than this number of tolerances is given with them."""


@dataclass(frozen=True, slots=True)
class CameraFault:
    """A fault of one or more cameras, in one line."""

    cameras: tuple[str, ...]
    """Empty: the images do not show which of the cameras is at fault."""
    text: str
    concerns_core: bool = False
    """Whether the core's image is not what the rig takes it for, so that no depth is right."""
    is_of_instant: bool = False
    """Whether the images are of another instant; else the cameras are not where the rig says."""


@dataclass(frozen=True, slots=True)
class FaultCauses:
    """Explanations of the inconsistencies of a frame."""

    exchanged: tuple[str, str] | None = None
    """Two cameras whose images fit the rig in each other's place."""
    instant: OtherInstant | None = None
    """A camera whose images fit those of the others at another instant."""
    mirroring: Mirroring | None = None
    """Cameras whose images fit the rig flipped."""
    quantities: tuple[WrongQuantity, ...] = ()
    """Quantities of the rig of which one, corrected, makes the images fit; the most likely first."""


def list_faults(
    consistency: RigConsistency, rig: Rig, causes: FaultCauses | None = None
) -> list[CameraFault]:
    """Return the inconsistencies with the cameras that they concern; none for a sound rig."""
    causes = causes or FaultCauses()
    fault = _find_misplaced(causes, rig)
    if fault is not None:
        return [fault]
    if consistency.is_sound:
        return []
    inconsistent = [each for each in consistency.cameras if each.camera in consistency.inconsistent]
    if consistency.core_moved:
        detail = _join(_describe_pose_change(consistency), _list_residuals(inconsistent, consistency))
        return [CameraFault((rig.core,), make_message("core_moved", detail=detail, camera=rig.core))]
    contradicting = [each for each in inconsistent if each.state == "contradicting"]
    faults: list[CameraFault] = []
    if consistency.suspects:
        faults.append(CameraFault((), _describe_suspects(contradicting, consistency)))
    elif contradicting and (consistency.ambiguous or not consistency.find_auxiliaries("sound")):
        faults.append(CameraFault((), _describe_without_sound_set(contradicting, rig, consistency, causes)))
    else:
        faults += [
            CameraFault((each.camera,), _describe_contradiction(each, consistency, causes))
            for each in contradicting
        ]
    faults += [
        CameraFault((each.camera,), _describe_unmatched(each))
        for each in inconsistent
        if each.state == "unmatched"
    ]
    return faults


def describe_undecided(consistency: RigConsistency, rig: Rig) -> list[str]:
    """Return a line about auxiliaries whose points leave open whether they agree with the rig; no fault by itself."""
    undecided = [each for each in consistency.cameras if each.state == "undecided"]
    if not undecided:
        return []
    core = "" if consistency.find_auxiliaries("sound") else f" or {rig.core}'s"
    counts = ", ".join(
        f"{each.camera} ({round(each.agreement * each.searched)} against {each.failing})"
        for each in undecided
    )
    return [
        f"fewer textured points agree with the rig than have no depth or lie elsewhere: {counts}; its image{core} "
        "may be of another instant (synchronisation) or hidden in part, or the rig is not these cameras'"
    ]


def _find_misplaced(misplaced: FaultCauses, rig: Rig) -> CameraFault | None:
    """Return the fault of images in another camera's place, of another instant or flipped."""
    if misplaced.exchanged is not None:
        one, other = misplaced.exchanged
        text = make_message("cameras_exchanged", one=one, other=other)
        return CameraFault((one, other), text, rig.core in (one, other))
    if misplaced.instant is not None:
        camera = misplaced.instant.camera
        return CameraFault((camera,), misplaced.instant.describe(), camera == rig.core, is_of_instant=True)
    mirrored = misplaced.mirroring
    if mirrored is None:
        return None
    cameras = () if len(mirrored.cameras) == len(rig.cameras) else mirrored.cameras
    return CameraFault(cameras, _describe_mirroring(mirrored), rig.core in mirrored.cameras)


def _describe_contradiction(each: CameraConsistency, consistency: RigConsistency, causes: FaultCauses) -> str:
    """Return the message of a camera that contradicts the rig, by whether a movement or the instant is likelier."""
    correction = _describe_correction(causes, each.camera)
    change = "" if correction else _describe_pose_change(consistency, each)
    return make_message(
        "camera_moved" if _is_smooth(each) else "camera_contradicts",
        subject=each.camera,
        detail=_join(*_list_evidence(each, consistency), change, correction),
        offset=round(each.epipolar_px, 2),
        sigma=round(each.epipolar_sigma_px, 2),
        limit=round(each.tolerance_px, 2),
        depth=round(each.depth_error_mm, 2) if each.depth_error_mm > 0 else 0.0,
    )


def _join(*parts: str) -> str:
    """Return the parts of the evidence that there are as one text."""
    return "; ".join(filter(None, parts))


def _is_smooth(each: CameraConsistency) -> bool:
    """Return whether one function of place explains the rows of nearly all points, as a movement or a lens does.

    Images of another instant differ where something moved, and agree elsewhere.
    """
    return each.rows.explained >= _SMOOTH * each.points


def _describe_unmatched(each: CameraConsistency) -> str:
    return make_message("camera_unmatched", subject=each.camera, points=each.points, searched=each.searched)


def _describe_mirroring(mirroring: Mirroring) -> str:
    names = ", ".join(mirroring.cameras)
    if mirroring.flip == "by 180°":
        return make_message("camera_turned", cameras=names)
    return make_message("camera_mirrored", detail=mirroring.flip, cameras=names)


def _describe_suspects(contradicting: list[CameraConsistency], consistency: RigConsistency) -> str:
    """Return the message of a frame that several movements explain."""
    residuals = _list_residuals(contradicting, consistency)
    return make_message("camera_moved_undecided", detail=residuals, cameras=", ".join(consistency.suspects))


def _describe_without_sound_set(
    contradicting: list[CameraConsistency], rig: Rig, consistency: RigConsistency, causes: FaultCauses
) -> str:
    """Return the message of a frame in which no set of auxiliaries is sound."""
    core = rig.core if len(consistency.cameras) == 1 else ""
    detail = _join(_list_residuals(contradicting, consistency), _describe_correction(causes, core=core))
    cameras = ", ".join((rig.core, *(each.camera for each in contradicting)))
    return make_message("cameras_contradict", detail=detail, cameras=cameras)


def _describe_correction(causes: FaultCauses, camera: str | None = None, core: str = "") -> str:
    """Return with which correction of the rig the images of a camera, or of any, fit; empty where none was found.

    ``core`` is given for a rig of two cameras: its own quantity may be wrong the other way round.
    """
    texts = [each.text for each in causes.quantities if camera in (None, each.camera)]
    if not texts:
        return ""
    if core:
        return f"rows meet when {', or '.join(texts)}, or {core}'s the other way round"
    return f"rows and depths meet when {', or '.join(texts)}"


def _list_residuals(cameras: list[CameraConsistency], consistency: RigConsistency) -> str:
    return ", ".join(_describe_residuals(each, consistency) for each in cameras)


def _describe_residuals(each: CameraConsistency, consistency: RigConsistency) -> str:
    """Return what a camera of several shows: its distance from its epipolar lines, and the other evidence."""
    offset = (
        f"{each.camera} is {each.epipolar_px:.2f} ± {each.epipolar_sigma_px:.2f} px off its epipolar lines "
        f"(allowed {each.tolerance_px:.2f})"
    )
    depth = f"{float(f'{each.depth_error_mm:.2g}'):g} mm of depth" if each.depth_error_mm > 0 else ""
    return ", ".join(filter(None, (offset, *_list_evidence(each, consistency), depth)))


def _list_evidence(each: CameraConsistency, consistency: RigConsistency) -> list[str]:
    """Return what a camera's points show beside their mean distance from the epipolar lines."""
    parts: list[str] = []
    low, high = each.rows.extent_px
    if not _is_smooth(each):
        parts.append(f"one movement fits {each.rows.explained} of {each.points} points at most")
    elif high - low > _SLOPED * each.tolerance_px:
        parts.append(f"{low:+.1f} to {high:+.1f} px over the image")
    if each.disparity_px > each.tolerance_px:
        parts.append(f"{each.disparity_px:.2f} px off the others' depth")
    if consistency.is_change:
        parts.append("farther than in the first frames")
    return parts


def _describe_pose_change(consistency: RigConsistency, each: CameraConsistency | None = None) -> str:
    change = consistency.pose_change
    if change is None or (each is not None and change.camera != each.camera):
        return ""
    return (
        f"a turn of {change.angle_deg:.3f} ± {change.angle_sigma_deg:.3f}° and a shift of {change.shift_mm:.2f} ± "
        f"{change.shift_sigma_mm:.2f} mm explain it"
    )


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


_DARK = 12.0
"""An image is dark if 99 % of its pixels are below this level of 255."""
_FEW_TEXTURED = 100
"""With fewer textured points in the core's image, the scene has hardly any texture."""


def diagnose_low_coverage(
    frame_set: FrameSet,
    rig: Rig,
    consistency: RigConsistency,
    depth_range_mm: tuple[float, float],
    coverage: float,
) -> tuple[str, bool]:
    """Return a line about the cause, and whether no image fits the rig, so that the depth is unreliable."""
    start = f"frame {frame_set.frame}: only {coverage:.0%} of the pixels are measured"
    if not coverage:
        start = f"frame {frame_set.frame}: no surface found"
    image = frame_set.images[rig.core]
    bright = float(np.percentile(image[::4, ::4], 99)) * 255 / np.iinfo(image.dtype).max
    if bright < _DARK:
        return (
            f"{start}: {rig.core}'s image is dark (99 % of it below {bright:.0f} of 255); expose longer",
            False,
        )
    if consistency.textured_points < _FEW_TEXTURED:
        return (
            f"{start}: {rig.core}'s image has hardly any texture ({consistency.textured_points} textured points); "
            "is the speckle projector on and in focus, and the exposure long enough?"
        ), False
    near, far = consistency.found_depth_range_mm
    if near < 0.98 * depth_range_mm[0] or far > 1.02 * depth_range_mm[1]:
        return (
            f"{start}: its points lie {near:.0f} to {far:.0f} mm away, the depth range is {depth_range_mm[0]:.0f} to "
            f"{depth_range_mm[1]:.0f} mm; give a --depth-range that holds them"
        ), False
    searched = [each for each in consistency.cameras if each.searched >= LEAST_TIE_POINTS]
    if searched and not np.isfinite(near) and not any(each.state == "sound" for each in searched):
        return (
            f"{start}, and no auxiliary image shows {rig.core}'s {consistency.textured_points} textured points where "
            "the rig predicts them: the cameras moved or were exchanged, the rig is another's, the images are of "
            "different instants, or there is too much noise"
        ), True
    return f"{start}; is the speckle projector on, and the exposure long enough?", False
