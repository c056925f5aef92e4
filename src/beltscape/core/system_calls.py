"""System calls that differ between Linux or macOS and Windows: locks, folders, memory, cores, keys, processes.

No other module asks which system it runs on. On Windows a lock is one byte of a file (`msvcrt.locking`), folders
cannot be opened, and a name in a folder needs no call to be durable. Systemd is told of start and liveness by the
protocol of sd_notify(3), without its library.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
import tempfile
import threading
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, TextIO

from beltscape.core.errors import SettingsError

if TYPE_CHECKING:
    from subprocess import Popen

CORES = "BELTSCAPE_CORES"
"""Variable of the environment: the most processor cores that one process may use."""

_DEPENDENT = "BELTSCAPE_DEPENDENT"
"""Variable of the environment of a command that ends with the program which began it."""
_END_S = 10.0
"""Time that such a command has to end in order: one that records closes its cameras in a second or two."""
_INTERFACE_ADDRESS = 0x8915
"""SIOCGIFADDR of Linux (netdevice(7)): the IPv4 address of an interface, at the bytes 20 to 23 of its record."""

if sys.platform == "win32":
    import msvcrt

    def lock_file(file: int) -> None:
        """Lock an open file until it is closed; BlockingIOError while another process or handle has it locked."""
        os.lseek(file, 0, os.SEEK_SET)
        try:
            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
        except PermissionError as error:
            raise BlockingIOError(error.errno, error.strerror) from error

    def lock_folder(folder: Path) -> int:
        """Lock a folder, by a file of the temporary folder; return what to close. Errors as `lock_file`."""
        name = sha256(str(folder.resolve()).encode()).hexdigest()[:16]
        handle = os.open(Path(tempfile.gettempdir()) / f"beltscape-{name}.lock", os.O_RDWR | os.O_CREAT)
        return _lock_or_close(handle)

    def sync_folder(folder: Path) -> None:
        """Do nothing: NTFS keeps the names of its journal."""

    def read_key(stream: TextIO) -> str:
        """Return one key of the console without waiting for Enter."""
        del stream  # the console is the only one
        return msvcrt.getwch()

else:
    import fcntl

    def lock_file(file: int) -> None:
        """Lock an open file until it is closed; BlockingIOError while another process or handle has it locked."""
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def lock_folder(folder: Path) -> int:
        """Lock a folder; return what to close. Errors as `lock_file`."""
        return _lock_or_close(os.open(folder, os.O_RDONLY | os.O_DIRECTORY))

    def sync_folder(folder: Path) -> None:
        """Wait until the names in a folder are on the disk."""
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)

    def read_key(stream: TextIO) -> str:
        """Return one key of a terminal without waiting for Enter."""
        import termios
        import tty

        file = stream.fileno()
        before = termios.tcgetattr(file)
        try:
            tty.setcbreak(file)
            return stream.read(1)
        finally:
            termios.tcsetattr(file, termios.TCSADRAIN, before)


def count_usable_cores() -> int:
    """Return the number of processor cores that this process may use, at most BELTSCAPE_CORES of the environment.

    Raises
    ------
    SettingsError
        When BELTSCAPE_CORES is not a positive whole number.
    """
    # Windows and macOS do not pin processes to cores by default
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    most = os.environ.get(CORES)
    return min(cores, _parse_cores(most)) if most else cores


def bind_to_free_core(folder: Path) -> int | None:
    """Keep this process, until it ends, to a core that no other process of this user took by this function.

    The locks are files below ``folder``, the same one for all these processes. Return the core's number; None
    without a free one, and on systems that do not bind processes to cores.
    """
    if not hasattr(os, "sched_setaffinity"):
        return None
    locks = folder / f"beltscape-cores-{os.getuid()}"
    locks.mkdir(mode=0o700, parents=True, exist_ok=True)
    for core in sorted(os.sched_getaffinity(0)):
        handle = os.open(locks / str(core), os.O_RDWR | os.O_CREAT, 0o600)
        try:
            lock_file(handle)  # the system frees it when the process ends
        except BlockingIOError:
            os.close(handle)
            continue
        for thread in Path("/proc/self/task").iterdir():
            os.sched_setaffinity(int(thread.name), {core})
        return core
    return None


def _parse_cores(text: str) -> int:
    if not (text.isascii() and text.isdigit() and int(text) > 0):
        raise SettingsError(
            f"{CORES}={text}: must be a whole number of at least 1; set it in the environment"
        )
    return int(text)


def sync_files() -> None:
    """Wait until all that was written is on the disk; Windows, which has no such call, is not asked."""
    if hasattr(os, "sync"):
        os.sync()


@dataclass(frozen=True, slots=True)
class SharedFile:
    """An open file of memory that a process which this one begins can open, too."""

    file: int
    """The open file."""
    name: str
    """What `open_shared_file` of the other process takes."""
    inherited: int | None
    """The open file that the other process must inherit; None: none."""

    def remove(self) -> None:
        """Remove the file's name, where it has one; both processes have closed it."""
        if self.inherited is None:
            Path(self.name).unlink(missing_ok=True)


def make_shared_file() -> SharedFile:
    """Return a new file of memory: without a name on Linux, else a file of the temporary folder."""
    if hasattr(os, "memfd_create"):
        file = os.memfd_create("beltscape")
        return SharedFile(file, f"inherited:{file}", file)
    file, name = tempfile.mkstemp(prefix="beltscape-")
    return SharedFile(file, name, None)


def open_shared_file(name: str) -> int:
    """Return a file of memory that the program which began this process made, open."""
    kind, _, number = name.partition(":")
    return int(number) if kind == "inherited" else os.open(name, os.O_RDWR | getattr(os, "O_BINARY", 0))


def begin_dependent(
    words: Sequence[str], folder: Path, locks: Sequence[int], stdout: int | IO[bytes], stderr: int
) -> Popen[bytes]:
    """Begin one of the program's commands in a folder; it ends when this process does, in whatever way.

    A killed process cannot end what it began, but the system closes its end of the pipe that is the command's
    standard input (`end_with_beginner`). ``locks`` are open files whose lock lasts until the command has ended, too;
    Windows does not hand them on. ``stdout`` and ``stderr`` are those of `subprocess.Popen`.
    """
    import subprocess

    inherited: dict[str, Any] = {} if sys.platform == "win32" else {"pass_fds": tuple(locks)}
    return subprocess.Popen(
        [sys.executable, "-m", "beltscape", *words], cwd=folder, stdin=subprocess.PIPE, stdout=stdout,
        stderr=stderr, env={**os.environ, "PYTHONUTF8": "1", _DEPENDENT: "1"}, **inherited,
    )  # fmt: skip


def end_with_beginner() -> None:
    """Let a process that was begun by `begin_dependent` end when its beginner does; for any other do nothing."""
    if os.environ.pop(_DEPENDENT, None) is None:
        return

    def wait_for_end() -> None:
        with suppress(OSError):
            while os.read(0, 1):
                pass
        os.kill(os.getpid(), signal.SIGTERM)  # one that is handled reaches the main thread
        threading.Event().wait(_END_S)
        os._exit(1)

    threading.Thread(target=wait_for_end, name="beginner", daemon=True).start()


def release_memory() -> None:
    """Give freed memory back to the system where the C library keeps it, as glibc does; elsewhere do nothing.

    Arrays of many sizes leave holes between them: a running system had 375 MiB after 25 minutes, with this 310.
    """
    import ctypes

    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    if trim is not None:
        trim(0)


def is_read_only(folder: Path) -> bool:
    """Return whether the file system of a folder is mounted read-only; False on Windows, which has no such call."""
    return hasattr(os, "statvfs") and bool(os.statvfs(folder).f_flag & os.ST_RDONLY)


def reserve_space(file: IO[bytes], size_bytes: int) -> None:
    """Allocate the space of an empty file; OSError if the disk has too little."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(file.fileno(), 0, size_bytes)
    else:  # Windows allocates what a file is extended by; macOS has no such call, and the file may be sparse
        file.truncate(size_bytes)


def _lock_or_close(handle: int) -> int:
    """Lock an open handle and return it; a file system without locks counts as locked."""
    try:
        lock_file(handle)
    except BlockingIOError:
        os.close(handle)
        raise
    except OSError:
        pass
    return handle


def list_interface_addresses() -> set[str]:
    """Return the IPv4 addresses of the network interfaces; empty on other systems than Linux."""
    found = set[str]()
    if sys.platform != "linux":
        return found
    from fcntl import ioctl

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        for _, name in socket.if_nameindex():
            with suppress(OSError):
                answer = ioctl(one.fileno(), _INTERFACE_ADDRESS, name.encode().ljust(40, b"\0"))
                found.add(socket.inet_ntoa(answer[20:24]))
    return found


def notify(state: str) -> bool:
    """Send a state such as "READY=1", "WATCHDOG=1", "STOPPING=1" or "STATUS=…"; return whether it was sent.

    Never raises and never waits: a program must not stop because its supervisor does not answer.
    """
    address = os.environ.get("NOTIFY_SOCKET", "")
    if address[:1] not in ("/", "@"):
        return False
    if address.startswith("@"):  # Linux's abstract namespace
        address = "\0" + address[1:]
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sock:
            sock.setblocking(False)
            sock.sendto(state.encode(), address)
    except OSError:
        return False
    return True


def watchdog_s() -> float | None:
    """Return after what time without "WATCHDOG=1" systemd restarts the program (send twice as often); None: never."""
    try:
        wait_us, process = int(os.environ["WATCHDOG_USEC"]), int(os.environ.get("WATCHDOG_PID", os.getpid()))
    except (KeyError, ValueError):
        return None
    return wait_us * 1e-6 if wait_us > 0 and process == os.getpid() else None
