"""What a frame's camera consistency means, in lines that name the camera, the figure and the fix."""

from __future__ import annotations

from beltscape.core.rig import Rig
from beltscape.stereo.consistency.check import CameraConsistency, RigConsistency

_FIX = "calibrate again"


def doubts_of(consistency: RigConsistency, rig: Rig, exchanged: tuple[str, str] | None = None) -> list[str]:
    """Return one line per contradiction; none for a sound rig."""
    if exchanged is not None:
        one, other = exchanged
        return [
            f"the images of {one} and {other} are exchanged: both fit the rig the other way round; "
            f"rename the two folders, or their cameras in rig.json"
        ]
    if consistency.is_sound:
        return []
    doubtful = [each for each in consistency.cameras if each.camera in consistency.doubtful]
    if consistency.core_moved:
        return [
            f"the core camera {rig.core} moved or its lens changed{_by(consistency)}: {_list(doubtful)}; {_FIX}"
        ]
    off = [each for each in doubtful if each.state == "contradicting"]
    lines = []
    if off and (consistency.ambiguous or not consistency.named("sound")):
        lines.append(_nobody(off, rig, consistency))
    else:
        lines += [
            f"{_figures(each)}: it moved or its lens changed{_by(consistency, each)}, or it is not the rig's camera; "
            f"{_FIX}"
            for each in off
        ]
    lines += [
        f"{each.camera}: no correspondence found ({each.points} of {each.searched} points): its lens is covered or "
        "out of focus, its image is of another instant, or the rig is another's"
        for each in doubtful
        if each.state == "unmatched"
    ]
    return lines


def _nobody(off: list[CameraConsistency], rig: Rig, consistency: RigConsistency) -> str:
    """No set of cameras is the sound one."""
    if len(consistency.cameras) == 1:
        return f"{_list(off)}: {rig.core} or {off[0].camera} moved, or the rig is another's; {_FIX}"
    names = " and ".join(filter(None, [", ".join(e.camera for e in off[:-1]), off[-1].camera]))
    if consistency.ambiguous and len(off) > 1:
        which = f"which of them or of {rig.core} moved, the images cannot tell"
        return f"{names} contradict each other: {_list(off)}; {which}; {_FIX}"
    which = f"{'they' if len(off) > 1 else off[0].camera} or {rig.core} moved, or the rig is another's"
    return f"no auxiliary agrees with {rig.core}: {_list(off)}: {which}; {_FIX}"


def _list(cameras: list[CameraConsistency]) -> str:
    return ", ".join(_figures(each) for each in cameras)


def _figures(each: CameraConsistency) -> str:
    text = (
        f"{each.camera} is {each.epipolar_px:.2f} ± {each.epipolar_sigma_px:.2f} px off its epipolar lines "
        f"(allowed {each.allowed_px:.2f})"
    )
    if each.along_px > each.allowed_px:
        text += f" and {each.along_px:.2f} px off the others' depth"
    return text


def _by(consistency: RigConsistency, each: CameraConsistency | None = None) -> str:
    motion = consistency.motion
    if motion is None or (each is not None and motion.camera != each.camera):
        return ""
    return f" (a turn of {motion.angle_deg:.2f}° and a shift of {motion.shift_mm:.2f} mm explain it)"
