"""The content of another program's rig file, before a core camera is chosen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig


@dataclass(frozen=True, slots=True)
class RigDescription:
    """Cameras, and the poses of those that have one in the file."""

    cameras: Mapping[str, Camera]
    """Cameras by name."""
    cam_from_reference: Mapping[str, Pose]
    """Poses by camera name, in any frame that all of them share; cameras without a pose are absent."""
    core: str
    """The file's reference camera, or the first."""

    def rig(self, core: str | None = None) -> Rig:
        """Return the rig relative to ``core``; ValueError if a camera has no pose."""
        core = core or self.core
        if core not in self.cameras:
            raise ValueError(f"no camera {core!r}; choose the core among {', '.join(self.cameras)}")
        if len(self.cameras) == 1:
            return Rig(core, self.cameras, {core: Pose.identity()})
        unplaced = [name for name in self.cameras if name not in self.cam_from_reference]
        if unplaced:
            raise ValueError(
                f"has no pose of {', '.join(unplaced)}; add its transform, or use the file as intrinsics"
            )
        poses = dict(self.cam_from_reference)
        if core != self.core or (poses[core].rotation_vector.any() or poses[core].translation_mm.any()):
            reference_from_core = poses[core].inverse()
            poses = {name: pose @ reference_from_core for name, pose in poses.items()}
        poses = {name: poses[name] for name in self.cameras}
        return Rig(core, self.cameras, {**poses, core: Pose.identity()})


def names_core_first(rig: Rig) -> list[str]:
    """Return the cameras' names, the core first, for formats whose first camera is the reference."""
    return [rig.core, *rig.auxiliaries]
