"""Texts of the camera faults of a frame: one line each, with the camera, the figure and the fix."""

from __future__ import annotations

from dataclasses import dataclass

from beltscape.core.geometry.rig import Rig
from beltscape.core.live.translatable_message import Message
from beltscape.stereo.consistency.diagnosis.instants import OtherInstant
from beltscape.stereo.consistency.diagnosis.mirroring import Mirroring
from beltscape.stereo.consistency.diagnosis.wrong_quantity import WrongQuantity
from beltscape.stereo.consistency.rig_consistency import CameraConsistency, RigConsistency

_FIX = "calibrate again"
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
        text = Message(
            f"the core camera {rig.core} moved or its lens changed{_describe_pose_change(consistency)}, or its "
            f"images are of another instant: {_list_residuals(inconsistent, consistency)}; {_FIX}, or check "
            "its trigger",
            "core_moved",
            camera=rig.core,
        )
        return [CameraFault((rig.core,), text)]
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
    """Return a line for each auxiliary whose points leave open whether it agrees with the rig; no fault by itself."""
    sound = consistency.find_auxiliaries("sound")
    whose = f"the rig or the images of {rig.core} or " if not sound else "the rig or its image: "
    return [
        f"{each.camera}: only {round(each.agreement * each.searched)} textured points agree with the rig, "
        f"{each.failing} do not or have no depth; check {whose}{'' if sound else each.camera + ': '}"
        "whether it is of another instant (synchronisation), hidden in part, or the rig is not these cameras'"
        for each in consistency.cameras
        if each.state == "undecided"
    ]


def _find_misplaced(misplaced: FaultCauses, rig: Rig) -> CameraFault | None:
    """Return the fault of images in another camera's place, of another instant or flipped."""
    if misplaced.exchanged is not None:
        one, other = misplaced.exchanged
        text = Message(
            f"the images of {one} and {other} are exchanged: both fit the rig the other way round; "
            f"rename the two folders, or their cameras in rig.json",
            "cameras_exchanged",
            one=one,
            other=other,
        )
        return CameraFault((one, other), text, rig.core in (one, other))
    if misplaced.instant is not None:
        camera = misplaced.instant.camera
        return CameraFault((camera,), misplaced.instant.describe(), camera == rig.core, is_of_instant=True)
    mirrored = misplaced.mirroring
    if mirrored is None:
        return None
    cameras = () if len(mirrored.cameras) == len(rig.cameras) else mirrored.cameras
    return CameraFault(cameras, _describe_mirroring(mirrored, rig), rig.core in mirrored.cameras)


def _describe_contradiction(each: CameraConsistency, consistency: RigConsistency, causes: FaultCauses) -> str:
    correction = _describe_correction(causes, each.camera)
    change = "" if correction else _describe_pose_change(consistency, each)
    instant, moved = (
        "its image is of another instant (synchronisation)",
        f"it moved or its lens changed{change}",
    )
    first, second = (moved, instant) if _is_smooth(each) else (instant, moved)
    return Message(
        f"{_describe_residuals(each, consistency)}: {first}, it is not the rig's camera, or {second}{correction}; "
        f"{_FIX}{'' if _is_smooth(each) else ', or check its trigger'}",
        "camera_moved",
        offset=round(each.epipolar_px, 2),
        sigma=round(each.epipolar_sigma_px, 2),
        limit=round(each.tolerance_px, 2),
        depth=round(max(each.depth_error_mm, 0.0), 2),
    )


def _is_smooth(each: CameraConsistency) -> bool:
    """Return whether one function of place explains the rows of nearly all points, as a movement or a lens does.

    Images of another instant differ where something moved, and agree elsewhere.
    """
    return each.rows.explained >= _SMOOTH * each.points


def _describe_unmatched(each: CameraConsistency) -> str:
    return Message(
        f"{each.camera}: no correspondence found ({each.points} of {each.searched} points): its lens is "
        "covered or out of focus, its image is of another instant (synchronisation), or the rig is another's",
        "camera_unmatched",
        points=each.points,
        searched=each.searched,
    )


def _describe_mirroring(mirroring: Mirroring, rig: Rig) -> str:
    names = mirroring.cameras
    whose = "all images are" if len(names) == len(rig.cameras) else f"the image of {', '.join(names)} is"
    how = "turned by 180°" if mirroring.flip == "by 180°" else f"mirrored {mirroring.flip}"
    text = f"{whose} {how}: flipped back, it fits the rig; switch the flip off in the camera's settings"
    return Message(
        text, "camera_turned" if mirroring.flip == "by 180°" else "camera_mirrored", cameras=", ".join(names)
    )


def _describe_suspects(contradicting: list[CameraConsistency], consistency: RigConsistency) -> str:
    """Return the line for a frame that several movements explain."""
    names = consistency.suspects
    text = (
        f"a camera may have moved, which one is not known yet: {', '.join(names[:-1])} or {names[-1]} "
        f"({_list_residuals(contradicting, consistency)}); the next frames decide, or {_FIX}"
    )
    return Message(text, "camera_moved_undecided", cameras=", ".join(names))


def _describe_without_sound_set(
    contradicting: list[CameraConsistency], rig: Rig, consistency: RigConsistency, causes: FaultCauses
) -> str:
    """Return the line for a frame in which no set of auxiliaries is sound."""
    core = rig.core if len(consistency.cameras) == 1 else ""
    correction = _describe_correction(causes, core=core)
    residuals, cameras = _list_residuals(contradicting, consistency), [each.camera for each in contradicting]
    if len(consistency.cameras) == 1:
        text = (
            f"{residuals}: {rig.core} or {cameras[0]} moved, the rig is another's, or their images are of different "
            f"instants{correction}; {_FIX}"
        )
        return Message(text, "cameras_contradict", cameras=", ".join((rig.core, *cameras)))
    if consistency.ambiguous and len(cameras) > 1:
        names = " and ".join(filter(None, [", ".join(cameras[:-1]), cameras[-1]]))
        text = (
            f"{names} contradict each other: {residuals}; the images do not show which of them or of {rig.core} "
            f"moved{correction}; {_FIX}"
        )
        return Message(text, "cameras_contradict", cameras=", ".join((rig.core, *cameras)))
    moved = f"{'they' if len(cameras) > 1 else cameras[0]} or {rig.core} moved"
    text = (
        f"no auxiliary agrees with {rig.core}: {residuals}: {moved}, the rig is another's, or {rig.core}'s image is "
        f"of another instant{correction}; {_FIX}"
    )
    return Message(text, "cameras_contradict", cameras=", ".join((rig.core, *cameras)))


def _describe_correction(causes: FaultCauses, camera: str | None = None, core: str = "") -> str:
    """Return with which correction of the rig the images of a camera, or of any, fit; empty where none was found.

    ``core`` is given for a rig of two cameras: its own quantity may be wrong the other way round.
    """
    texts = [each.text for each in causes.quantities if camera in (None, each.camera)]
    if not texts:
        return ""
    if core:
        return f"; rows meet when {', or '.join(texts)}, or {core}'s the other way round"
    return f"; rows and depths meet when {', or '.join(texts)}"


def _list_residuals(cameras: list[CameraConsistency], consistency: RigConsistency) -> str:
    return ", ".join(_describe_residuals(each, consistency) for each in cameras)


def _describe_residuals(each: CameraConsistency, consistency: RigConsistency) -> str:
    since = "further " if consistency.is_change else ""
    text = (
        f"{each.camera} is {each.epipolar_px:.2f} ± {each.epipolar_sigma_px:.2f} px {since}off its epipolar lines "
        f"(allowed {each.tolerance_px:.2f})"
    )
    low, high = each.rows.extent_px
    if not _is_smooth(each):
        text += f" in {each.points} points, of which {each.rows.explained} at most fit one movement"
    elif high - low > _SLOPED * each.tolerance_px:
        text += f", {low:+.1f} to {high:+.1f} px over the image"
    if each.disparity_px > each.tolerance_px:
        text += f" and {each.disparity_px:.2f} px off the others' depth"
    if each.depth_error_mm > 0:
        text += f", as much as {float(f'{each.depth_error_mm:.2g}'):g} mm of depth"
    return text + (" than in the first frames" if consistency.is_change else "")


def _describe_pose_change(consistency: RigConsistency, each: CameraConsistency | None = None) -> str:
    change = consistency.pose_change
    if change is None or (each is not None and change.camera != each.camera):
        return ""
    return (
        f" (a turn of {change.angle_deg:.3f} ± {change.angle_sigma_deg:.3f}° and a shift of {change.shift_mm:.2f} ± "
        f"{change.shift_sigma_mm:.2f} mm explain it)"
    )
