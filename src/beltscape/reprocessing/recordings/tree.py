"""Folders and files of a source: those of a file system or bucket, and those in an archive, listed alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, Protocol

from beltscape.core.errors import InputError
from beltscape.reprocessing.recordings.archives import KINDS, list_archive, normalise_name
from beltscape.reprocessing.recordings.recording import Place
from beltscape.reprocessing.recordings.storage import (
    follow_link,
    is_local,
    join_address,
    named_faults,
    open_storage,
    resolve_links,
)


@dataclass(frozen=True, slots=True)
class FileEntry:
    """A file as its folder lists it."""

    path: str
    """By which `Place.read` reads it, relative to its folder."""
    size: int
    stamp: str
    """What tells a changed file: a checksum, an entity tag, or the time of its last change."""


@dataclass(frozen=True, slots=True)
class Folder:
    """Contents of a folder."""

    folders: set[str] = field(default_factory=set[str])
    files: dict[str, FileEntry] = field(default_factory=dict[str, FileEntry])
    others: set[str] = field(default_factory=set[str])
    """Pipes, sockets, devices, and links to nothing."""


class Tree(Protocol):
    """A root folder with all below it; paths are relative to it, with "/", empty for the root."""

    mark: str
    """What tells a changed archive; empty for folders."""

    def list_folder(self, path: str) -> Folder:
        """Return what a folder holds; InputError if it cannot be listed, UnreachableError if its store is away."""
        ...

    def list_folders(self, paths: Sequence[str]) -> list[Folder]:
        """Return what several folders hold, as `list_folder`."""
        ...

    def place(self, path: str) -> Place:
        """Return the place of a folder."""
        ...

    def identify(self, path: str) -> str:
        """Return one text for a folder whatever the links on the way to it."""
        ...


class StorageTree:
    """Folders of a file system or of a bucket."""

    mark = ""

    def __init__(self, url: str) -> None:
        self._url = url

    def list_folder(self, path: str) -> Folder:
        """Return what a folder holds."""
        url = join_address(self._url, path)
        with named_faults(url):
            file_system, own = open_storage(url)
            entries: list[dict[str, Any]] = file_system.ls(own, detail=True, refresh=True)
        folder = Folder()
        for entry in entries:
            name = str(entry["name"]).rstrip("/").rpartition("/")[2]
            if not name or str(entry["name"]).strip("/") == own.strip("/"):
                continue  # an object store may list the folder itself
            followed = follow_link(entry) if entry.get("islink") else entry
            if followed["type"] == "directory":
                folder.folders.add(name)
            elif followed["type"] == "file":
                folder.files[name] = FileEntry(name, int(followed.get("size") or 0), choose_stamp(followed))
            else:
                folder.others.add(name)
        return folder

    def list_folders(self, paths: Sequence[str]) -> list[Folder]:
        """Return what several folders hold; those of an object store are requested at the same time."""
        if is_local(self._url) or len(paths) < 2:
            return [self.list_folder(path) for path in paths]
        with ThreadPoolExecutor(len(paths)) as pool:
            return list(pool.map(self.list_folder, paths))

    def place(self, path: str) -> Place:
        """Return the place of a folder."""
        return Place(join_address(self._url, path))

    def identify(self, path: str) -> str:
        """Return the path without links; object stores have none."""
        url = join_address(self._url, path)
        return resolve_links(url) if is_local(url) else url


class ArchiveTree:
    """Folders in an archive, which is listed once."""

    def __init__(self, kind: str, url: str, mark: str) -> None:
        """List the archive; InputError if it is damaged, UnreachableError if its store is away."""
        self._kind, self._url, self.mark = kind, url, mark
        self._folders: dict[str, Folder] = {"": Folder()}
        self.outside: list[str] = []
        """Members that would leave the archive's root; they are not read."""
        for name, member in list_archive(kind, url).items():
            path = normalise_name(name)
            if not path:
                self.outside.append(name)
                continue
            parent, _, base = path.rpartition("/")
            entry = FileEntry(member.append_range(base), member.size, member.stamp)
            self._folder(parent).files[base] = entry

    def _folder(self, path: str) -> Folder:
        """Return a folder, which is added with those above it."""
        if path not in self._folders:
            parent, _, base = path.rpartition("/")
            self._folder(parent).folders.add(base)
            self._folders[path] = Folder()
        return self._folders[path]

    def list_folder(self, path: str) -> Folder:
        """Return what a folder holds."""
        if path not in self._folders:
            raise InputError(f"{join_address(self._url, path)}: no such folder in the archive")
        return self._folders[path]

    def list_folders(self, paths: Sequence[str]) -> list[Folder]:
        """Return what several folders hold."""
        return [self.list_folder(path) for path in paths]

    def place(self, path: str) -> Place:
        """Return the place of a folder."""
        return Place(f"{self._kind}://{path}::{self._url}")

    def identify(self, path: str) -> str:
        """Return the address: an archive's links are not followed."""
        return join_address(self._url, path)


def find_archive_kind(name: str) -> str | None:
    """Return the kind of archive by a file's name; None for other files."""
    return next((kind for end, kind in KINDS.items() if name.lower().endswith(end)), None)


def choose_stamp(entry: Mapping[str, Any]) -> str:
    """Return what tells a changed file of a listing: entity tag, or time of its last change."""
    values = (entry.get(key) for key in ("ETag", "md5Hash", "etag", "mtime", "LastModified", "created"))
    return str(next((value for value in values if value), ""))
