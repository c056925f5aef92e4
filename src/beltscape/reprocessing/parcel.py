"""A project as bytes for a worker: its settings, rig and empty belt.

Densities and products are left out: they change masses only, which are computed where the pieces are joined.
"""

from __future__ import annotations

import atexit
import hashlib
import shutil
import tempfile
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from beltscape import __version__
from beltscape.core.progress import Reporter
from beltscape.files.belt_json import write_belt
from beltscape.measure.belt.settings import NOTHING_GIVEN, GivenBelt
from beltscape.pipeline.live.project import CaptureSettings, Project, RunSettings
from beltscape.pipeline.measuring.belt import hash_empty_belt, read_empty_belt

_RIG, _BELT = "rig.json", "belt.json"


@dataclass(frozen=True, slots=True)
class Parcel:
    """The settings of a project, and the files that they name."""

    settings: RunSettings
    """With paths relative to the folder into which the files are unpacked."""
    files: tuple[tuple[str, bytes], ...]
    """Name → content."""
    empty_sha256: str
    """Digest of what the empty belt was fitted to."""

    @property
    def digest(self) -> str:
        """Return the SHA-256 of all that decides the volumes: settings, rig, empty belt and the program's version.

        A fit's last bits depend on the kind of processor; so the digest is of what the empty belt was fitted to, and
        a run goes on on another machine.
        """
        parts = [__version__.encode(), self.settings.model_dump_json().encode()]
        digests = [hashlib.sha256(part).digest() for part in parts]
        digests += [
            bytes.fromhex(self.empty_sha256) if name == _BELT else hashlib.sha256(content).digest()
            for name, content in self.files
        ]
        return hashlib.sha256(b"".join(digests)).hexdigest()


def pack_project(project: Project[RunSettings], reporter: Reporter) -> Parcel:
    """Return the parcel of a project; InputError if one of its files cannot be read."""
    settings = project.settings
    empty = project.resolve(settings.empty)
    files = {
        _RIG: project.resolve(settings.rig).read_bytes(),
        _BELT: _read_belt_file(empty, settings.belt, reporter),
    }
    own = RunSettings(
        name=settings.name,
        rig=Path(_RIG),
        empty=Path(_BELT),
        capture=CaptureSettings(folder=Path("recording")),
        matching=settings.matching.model_copy(update={"threads": 0}),
        flow=settings.flow,
        health=settings.health,
    )
    digest = hash_empty_belt(empty)
    if settings.belt != NOTHING_GIVEN:
        digest = hashlib.sha256(f"{digest} {settings.belt.model_dump_json()}".encode()).hexdigest()
    return Parcel(own, tuple(sorted(files.items())), digest)


def unpack_project(parcel: Parcel) -> Project[RunSettings]:
    """Return the project of a parcel, unpacked once into a temporary folder of this process."""
    folder = _unpack(parcel.files)
    return Project(folder / "project.toml", parcel.settings)


@lru_cache(maxsize=2)
def _unpack(files: tuple[tuple[str, bytes], ...]) -> Path:
    folder = Path(tempfile.mkdtemp(prefix="beltscape-worker-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    for name, content in files:
        (folder / name).write_bytes(content)
    return folder


def _read_belt_file(empty: Path, given: GivenBelt, reporter: Reporter) -> bytes:
    """Return the belt.json of an empty belt, which may be a frame or a whole reconstruction, with what is given."""
    if empty.is_file() and given == NOTHING_GIVEN:
        return empty.read_bytes()
    belt, camera = read_empty_belt(empty, reporter, given)
    with tempfile.TemporaryDirectory() as folder:
        write_belt(Path(folder) / _BELT, belt, camera)
        return (Path(folder) / _BELT).read_bytes()
