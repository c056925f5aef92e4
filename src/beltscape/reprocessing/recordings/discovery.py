"""Finding of all recordings below a source, of what there cannot be read, and of what it holds more than once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from hashlib import sha256

from beltscape.core.errors import InputError
from beltscape.core.progress import Reporter
from beltscape.files.frame_names import natural_key
from beltscape.files.images import EXTENSIONS
from beltscape.files.output_folder import MANIFEST, STAGING, describe_unfinished, parse_manifest
from beltscape.files.paths import summarise_names
from beltscape.reprocessing.recordings.capture_files import CaptureListing, CaptureOptions, make_recording
from beltscape.reprocessing.recordings.recording import Place, Recording, Unreadable
from beltscape.reprocessing.recordings.storage import (
    UnreachableError,
    is_local,
    named_faults,
    normalise_address,
    open_storage,
)
from beltscape.reprocessing.recordings.tree import (
    ArchiveTree,
    Folder,
    StorageTree,
    Tree,
    choose_stamp,
    find_archive_kind,
)


def separate_duplicates(recordings: Sequence[Recording]) -> tuple[list[Recording], list[Unreadable]]:
    """Return each recording once, in natural order of the names, and a line for every other copy.

    Copies have the name of the capture, its frames, times and positions in common. The copy with most images is kept,
    of several that in a folder, which is read faster than an archive.
    """
    kept: dict[str, Recording] = {}
    copies: list[Unreadable] = []
    for recording in sorted(recordings, key=_rank):
        first = kept.setdefault(_identify(recording), recording)
        if first is not recording:
            reason = (
                f"is the same recording as {first.name} (name, frames, times and positions are equal) "
                "and is counted once; remove one of them"
            )
            copies.append(Unreadable(recording.name, reason))
    return sorted(kept.values(), key=lambda one: natural_key(one.name)), copies


def _rank(recording: Recording) -> tuple[int, bool, tuple[tuple[int, int | str], ...]]:
    images = sum(len(frame.files) for frame in recording.frames)
    return -images, recording.place.archive is not None, natural_key(recording.name)


def _identify(recording: Recording) -> str:
    """Return a digest of the capture's name, frames, times and positions."""
    base = recording.name.rpartition("/")[2]
    end = base if find_archive_kind(base) is None else base.partition(".")[0]
    rows = (f"{frame.frame}\0{frame.time_ns}\0{frame.position_mm!r}\n" for frame in recording.frames)
    return sha256("".join([end, "\n", *rows]).encode("utf-8", "surrogateescape")).hexdigest()


_OTHER_ARCHIVES = (".7z", ".rar", ".bz2", ".xz", ".zst", ".tbz", ".txz", ".gz")
_PART = "is being written or was interrupted; start the recorder, which finishes it, and run it again"
_DEEPEST = 50
"""Levels of folders that are searched; recordings lie two or three deep."""


def find_recordings(
    source: str,
    cameras: Mapping[str, tuple[int, int]],
    core: str,
    *,
    with_positions: bool,
    frames_per_s: float | None,
    reporter: Reporter,
) -> tuple[list[Recording], list[Unreadable]]:
    """Return the recordings below a source in natural order of their names, and what could not be read.

    ``source`` is a capture, a folder of captures at any depth, an archive (zip, tar, tar.gz, tgz) or an address that
    fsspec knows, such as ``s3://bucket/folder``. ``cameras``: camera of the rig → (width, height) px. Times and
    positions come from each capture's encoder.csv (``with_positions``), or only its times, or from ``frames_per_s``.

    Raises
    ------
    InputError
        When the source is not there, does not answer, or holds no recording.
    """
    if not source:
        raise InputError("the source is empty; give the folder, archive or address of the recordings")
    address = normalise_address(source)
    search = _Search(CaptureOptions(cameras, core, with_positions, frames_per_s), reporter)
    search.start(address)
    if not search.recordings:
        raise InputError(search.describe_failure(address))
    recordings, duplicates = separate_duplicates(search.recordings)
    return recordings, sorted([*search.unreadable, *duplicates], key=lambda one: natural_key(one.name))


class _Search:
    """Walk through a source."""

    def __init__(self, options: CaptureOptions, reporter: Reporter) -> None:
        self._options, self._reporter = options, reporter
        self.recordings: list[Recording] = []
        self.unreadable: list[Unreadable] = []
        self._hidden: list[str] = []
        self._names: dict[str, str] = {}
        """Name of each folder that was searched, by its path without links."""
        self._is_local = True
        self._other_images = ""
        """A folder with images that belongs to no camera of the rig."""

    def start(self, address: str) -> None:
        """Search everything below an address."""
        archive = Place(address).archive
        if archive is None:
            self._is_local = is_local(address)
            self._search_address(address)
        else:
            outer = normalise_address(archive[2])
            self._is_local = is_local(outer)
            self._search_archive(archive[0], outer, _base(outer), archive[1].strip("/"))
        if self._hidden:
            shown = summarise_names(self._hidden)
            self._reporter.warn(f"{address}: hidden files and folders are left out: {shown}")

    def _search_address(self, address: str) -> None:
        with named_faults(address):
            file_system, path = open_storage(address)
            info = file_system.info(path)
        if info["type"] == "directory":
            tree = StorageTree(address)
            tree.list_folder("")  # a source that cannot be listed ends the search
            self._walk(tree, "", "", _base(address), 0)
        elif kind := find_archive_kind(address):
            self._search_archive(kind, address, _base(address))
        else:
            raise InputError(f"{address}: is a file; give a folder, or an archive: .zip, .tar, .tar.gz, .tgz")

    def describe_failure(self, address: str) -> str:
        """Return why no recording was found, with the fix."""
        if self.unreadable:
            first, more = self.unreadable[0], len(self.unreadable) - 1
            others = f" (and {more} more that cannot be read)" if more else ""
            return f"{address}: no recording that can be read; {first.name}: {first.reason}{others}"
        other = (
            f"; {self._other_images} has images, but is no camera of the rig" if self._other_images else ""
        )
        return (
            f"{address}: no recording in it: a folder with images of the core camera in {self._options.core}/"
            f"{other}; give the recorder's folder or the rig of these recordings"
        )

    def _walk(self, tree: Tree, path: str, name: str, base: str, depth: int) -> None:
        """Search a folder; ``name`` is its name in reports, ``base`` that of a source that is itself a capture."""
        own = name or base
        try:
            folder, identity = tree.list_folder(path), tree.identify(path)
            if identity in self._names:
                also = self._names[identity] or "the source"
                raise InputError(
                    f"{tree.place(path).address}: is by a link the same folder as {also}; remove the link"
                )
            self._names[identity] = name
            if depth > _DEEPEST:
                raise InputError(
                    f"{tree.place(path).address}: deeper than {_DEEPEST} folders; give it as the source"
                )
            _require_finished(tree, path, folder)
            if self._take_capture(tree, path, own, folder):
                return
        except InputError as error:
            self._report(own, error)
            return
        self._note_images(tree, path, folder)
        for child in sorted(folder.folders, key=natural_key):
            if child.startswith("."):
                self._hidden.append(child)
            elif child.endswith(".part"):
                self.unreadable.append(Unreadable(_join(name, child), _PART))
            else:
                self._walk(tree, _join(path, child), _join(name, child), base, depth + 1)
        self._search_files(tree, path, name, folder)

    def _search_files(self, tree: Tree, path: str, name: str, folder: Folder) -> None:
        """Search the archives among a folder's files."""
        for file in sorted(folder.files, key=natural_key):
            kind = find_archive_kind(file)
            if file.startswith("."):
                self._hidden.append(file)
            elif kind and isinstance(tree, StorageTree):
                self._search_archive(kind, tree.place(_join(path, file)).url, _join(name, file))
            elif kind:
                self.unreadable.append(
                    Unreadable(_join(name, file), "is an archive in an archive; unpack the outer one")
                )
            elif file.lower().endswith(_OTHER_ARCHIVES):
                reason = "archives of this kind are not read; pack it as .zip, .tar, .tar.gz or .tgz"
                self.unreadable.append(Unreadable(_join(name, file), reason))

    def _search_archive(self, kind: str, url: str, name: str, inner: str = "") -> None:
        try:
            tree = ArchiveTree(kind, url, _measure_mark(url))
        except InputError as error:
            self._report(name, error)
            return
        if tree.outside:
            shown = summarise_names(tree.outside)
            self._reporter.warn(f"{url}: members that would leave the archive's folder are left out: {shown}")
        self._walk(tree, inner, name, name, 0)

    def _take_capture(self, tree: Tree, path: str, name: str, folder: Folder) -> bool:
        """Add the recording of a folder if it is a capture; InputError for a capture that cannot be measured."""
        names = [camera for camera in self._options.cameras if camera in folder.folders]
        listed = tree.list_folders([_join(path, camera) for camera in names])
        cameras = dict(zip(names, listed, strict=True))
        with_images = [camera for camera, own in cameras.items() if _has_images(own)]
        if not with_images:
            return False
        if self._options.core not in with_images:
            address = tree.place(path).address
            raise InputError(
                f"{address}/{self._options.core}: no images of the core camera {self._options.core}; the capture has "
                f"{', '.join(with_images)}"
            )
        listing = CaptureListing(tree, path, name, folder, cameras)
        self.recordings.append(make_recording(listing, self._options, self._reporter))
        return True

    def _note_images(self, tree: Tree, path: str, folder: Folder) -> None:
        if not self._other_images and _has_images(folder):
            self._other_images = tree.place(path).address

    def _report(self, name: str, error: InputError) -> None:
        """Add what cannot be read; raise the error where a whole store is away, with all that is in it."""
        if isinstance(error, UnreachableError) and not self._is_local:
            raise error
        self.unreadable.append(Unreadable(name, " ".join(str(error).split())))


def _base(address: str) -> str:
    return address.rstrip("/").rpartition("/")[2]


def _join(folder: str, name: str) -> str:
    return f"{folder}/{name}" if folder else name


def _has_images(folder: Folder) -> bool:
    return any(name.lower().endswith(EXTENSIONS) and not name.startswith(".") for name in folder.files)


def _require_finished(tree: Tree, path: str, folder: Folder) -> None:
    """Raise InputError for the output of a command that was interrupted or still runs."""
    manifest, place = None, tree.place(path)
    if MANIFEST in folder.files:
        try:
            manifest = parse_manifest(place.read(folder.files[MANIFEST].path))
        except ValueError:
            return  # as `require_finished` of a folder
    reason = describe_unfinished(manifest, is_staged=STAGING in folder.folders)
    if reason:
        raise InputError(f"{place.address}: {reason}")


def _measure_mark(url: str) -> str:
    """Return what tells a changed archive: its size and its stamp."""
    with named_faults(url):
        file_system, path = open_storage(url)
        info = file_system.info(path)
    return f"{info.get('size')} {choose_stamp(info)}"
