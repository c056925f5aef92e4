"""Texts of the camera faults of a frame: one line each, with the camera, the figure and the fix."""

from __future__ import annotations

from beltscape.core.geometry.rig import Rig
from beltscape.stereo.consistency.rig_consistency import CameraConsistency, RigConsistency

_FIX = "calibrate again"


def describe_faults(
    consistency: RigConsistency, rig: Rig, exchanged: tuple[str, str] | None = None
) -> list[str]:
    """Return one line per inconsistency; none for a sound rig."""
    if exchanged is not None:
        one, other = exchanged
        return [
            f"the images of {one} and {other} are exchanged: both fit the rig the other way round; "
            f"rename the two folders, or their cameras in rig.json"
        ]
    if consistency.is_sound:
        return []
    inconsistent = [each for each in consistency.cameras if each.camera in consistency.inconsistent]
    if consistency.core_moved:
        return [
            f"the core camera {rig.core} moved or its lens changed{_describe_pose_change(consistency)}: "
            f"{_list_residuals(inconsistent)}; {_FIX}"
        ]
    contradicting = [each for each in inconsistent if each.state == "contradicting"]
    lines: list[str] = []
    if contradicting and (consistency.ambiguous or not consistency.find_auxiliaries("sound")):
        lines.append(_describe_without_sound_set(contradicting, rig, consistency))
    else:
        lines += [
            f"{_describe_residuals(each)}: it moved or its lens changed{_describe_pose_change(consistency, each)}, "
            f"or it is not the rig's camera; {_FIX}"
            for each in contradicting
        ]
    lines += [
        f"{each.camera}: no correspondence found ({each.points} of {each.searched} points): its lens is covered or "
        "out of focus, its image is of another instant, or the rig is another's"
        for each in inconsistent
        if each.state == "unmatched"
    ]
    return lines


def _describe_without_sound_set(
    contradicting: list[CameraConsistency], rig: Rig, consistency: RigConsistency
) -> str:
    """Return the line for a frame in which no set of auxiliaries is sound."""
    residuals, cameras = _list_residuals(contradicting), [each.camera for each in contradicting]
    if len(consistency.cameras) == 1:
        return f"{residuals}: {rig.core} or {cameras[0]} moved, or the rig is another's; {_FIX}"
    if consistency.ambiguous and len(cameras) > 1:
        names = " and ".join(filter(None, [", ".join(cameras[:-1]), cameras[-1]]))
        return (
            f"{names} contradict each other: {residuals}; the images do not show which of them or of {rig.core} "
            f"moved; {_FIX}"
        )
    moved = f"{'they' if len(cameras) > 1 else cameras[0]} or {rig.core} moved"
    return f"no auxiliary agrees with {rig.core}: {residuals}: {moved}, or the rig is another's; {_FIX}"


def _list_residuals(cameras: list[CameraConsistency]) -> str:
    return ", ".join(_describe_residuals(each) for each in cameras)


def _describe_residuals(each: CameraConsistency) -> str:
    text = (
        f"{each.camera} is {each.epipolar_px:.2f} ± {each.epipolar_sigma_px:.2f} px off its epipolar lines "
        f"(allowed {each.tolerance_px:.2f})"
    )
    if each.disparity_px > each.tolerance_px:
        text += f" and {each.disparity_px:.2f} px off the others' depth"
    return text


def _describe_pose_change(consistency: RigConsistency, each: CameraConsistency | None = None) -> str:
    change = consistency.pose_change
    if change is None or (each is not None and change.camera != each.camera):
        return ""
    return f" (a turn of {change.angle_deg:.2f}° and a shift of {change.shift_mm:.2f} mm explain it)"
