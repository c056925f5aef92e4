"""What a file of another program says of a rig, before a core camera is chosen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from beltscape.core.camera import Camera
from beltscape.core.pose import Pose
from beltscape.core.rig import Rig


@dataclass(frozen=True, slots=True)
class Described:
    """Cameras, and where those stand whose place the file tells."""

    cameras: Mapping[str, Camera]
    """By name."""
    cam_from_reference: Mapping[str, Pose]
    """By name; the reference is any frame that all of them share. Cameras without a place are absent."""
    core: str
    """The camera the file itself refers to, or the first."""

    def rig(self, core: str | None = None) -> Rig:
        """The rig about ``core``, or ValueError where a camera's place is not told."""
        core = core or self.core
        if core not in self.cameras:
            raise ValueError(f"no camera {core!r}; choose the core among {', '.join(self.cameras)}")
        if len(self.cameras) == 1:
            return Rig(core, self.cameras, {core: Pose.identity()})
        unplaced = [name for name in self.cameras if name not in self.cam_from_reference]
        if unplaced:
            raise ValueError(
                f"does not tell where {', '.join(unplaced)} stands; add its transform, or use the file as intrinsics"
            )
        poses = dict(self.cam_from_reference)
        if core != self.core or (poses[core].rotation_vector.any() or poses[core].translation_mm.any()):
            reference_from_core = poses[core].inverse()
            poses = {name: pose @ reference_from_core for name, pose in poses.items()}
        poses = {name: poses[name] for name in self.cameras}
        return Rig(core, self.cameras, {**poses, core: Pose.identity()})


def core_first(rig: Rig) -> list[str]:
    """Names of the cameras, the core at the head, for formats whose first camera is the reference."""
    return [rig.core, *rig.auxiliaries]
