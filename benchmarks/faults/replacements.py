"""What a project names instead of what belongs to it: the rig of another plant, another or a damaged empty belt."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from beltscape.core.geometry.pose import Pose
from beltscape.files.rig_json import read_rig, write_rig


@dataclass(frozen=True)
class Named:
    """The files that a project names."""

    rig: Path
    empty: Path


def _name_other_rig(named: Named, folder: Path) -> Named:
    """Return the project of a rig whose cameras are mounted 3 % farther apart."""
    rig = read_rig(named.rig)
    poses = {
        name: Pose(pose.rotation, np.asarray(1.03 * pose.translation_mm))
        for name, pose in rig.cam_from_core.items()
    }
    write_rig(folder / "other_rig.json", replace(rig, cam_from_core=poses))
    return replace(named, rig=folder / "other_rig.json")


def _damage_empty_belt(named: Named, folder: Path) -> Named:
    """Return the project with some bytes of the empty belt's depth flipped."""
    shutil.copytree(named.empty, folder / "damaged_empty")
    path = max((folder / "damaged_empty").rglob("depth*"), key=lambda file: file.stat().st_size)
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 4] = bytes(byte ^ 0xFF for byte in data[middle : middle + 4])
    path.write_bytes(data)
    return replace(named, empty=folder / "damaged_empty")


REPLACEMENTS: Mapping[str, Callable[[Named, Path], Named]] = {
    "rig": _name_other_rig,
    "empty belt's bytes": _damage_empty_belt,
}
"""By name: from what belongs to the project, and a folder for files, to what it names."""
