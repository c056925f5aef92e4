"""System calls on this system, and on Windows as far as its modules can be played here."""

from __future__ import annotations

import os
import platform
import re
import subprocess
import sys
from pathlib import Path

import pytest

import beltscape
from beltscape.core.errors import SettingsError
from beltscape.core.system_calls import (
    CORES,
    count_usable_cores,
    lock_file,
    lock_folder,
    reserve_space,
    sync_folder,
)
from tests.synthetic.demo import DEMO

POSIX_MODULES = ("fcntl", "termios", "tty", "pty", "resource", "pwd", "grp", "posix")
POSIX_CALLS = (
    "O_DIRECTORY", "chown", "fchmod", "fork", "getgid", "getuid", "mkfifo", "posix_fallocate", "pread", "pwrite",
    "sched_getaffinity", "statvfs", "sync",
)  # fmt: skip
WINDOWS = (
    f"MODULES, CALLS = {POSIX_MODULES}, {POSIX_CALLS}"
    + """
import encodings.idna, errno, multiprocessing, os, pkgutil, signal, subprocess, sys, tempfile, types
from pathlib import Path
LOCKS = {}
class Console(types.ModuleType):
    LK_NBLCK = 2
    def locking(self, file, mode, count):
        assert (mode, count, os.lseek(file, 0, os.SEEK_CUR)) == (self.LK_NBLCK, 1, 0)
        one = os.fstat(file).st_ino
        holder = LOCKS.get(one)
        if holder is not None and holder != file and is_open(holder, one):
            raise PermissionError(errno.EACCES, "Permission denied")
        LOCKS[one] = file
    def getwch(self):
        return "q"
def is_open(file, one):
    try:
        return os.fstat(file).st_ino == one
    except OSError:
        return False
for name in MODULES:
    sys.modules[name] = None
for name in CALLS:
    delattr(os, name)
sys.modules["msvcrt"] = Console("msvcrt")
here, sys.platform = sys.platform, "win32"
import beltscape.core.system_calls as calls
sys.platform = here
"""
)
"""What a process sees on Windows: no POSIX modules and calls, and locks of single bytes by msvcrt."""


def run_on_windows(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", WINDOWS + code], capture_output=True, text=True, check=False, cwd=folder
    )


def test_a_file_is_locked_once_and_again_after_it_is_closed(tmp_path):
    with (tmp_path / "lock").open("ab") as first, (tmp_path / "lock").open("rb") as second:
        lock_file(first.fileno())
        with pytest.raises(BlockingIOError):
            lock_file(second.fileno())
        first.close()
        lock_file(second.fileno())


def test_a_folder_is_locked_once(tmp_path):
    handle = lock_folder(tmp_path)
    with pytest.raises(BlockingIOError):
        lock_folder(tmp_path)
    os.close(handle)
    os.close(lock_folder(tmp_path))
    assert not list(tmp_path.iterdir())


def test_space_is_reserved_and_a_folder_synchronised(tmp_path):
    with (tmp_path / "reserve").open("wb") as file:
        reserve_space(file, 1 << 16)
    assert (tmp_path / "reserve").stat().st_size == 1 << 16
    sync_folder(tmp_path)


def test_windows_locks_files_and_folders(tmp_path):
    done = run_on_windows(
        """
with open("lock", "ab") as first, open("lock", "rb") as second:
    calls.lock_file(first.fileno())
    try:
        calls.lock_file(second.fileno())
    except BlockingIOError:
        print("locked")
    first.close()
    calls.lock_file(second.fileno())
handle = calls.lock_folder(Path())
try:
    calls.lock_folder(Path())
except BlockingIOError:
    print("locked")
os.close(handle)
os.close(calls.lock_folder(Path()))
with open("reserve", "wb") as file:
    calls.reserve_space(file, 4096)
calls.sync_folder(Path())
print(calls.read_key(sys.stdin), sorted(path.name for path in Path().iterdir()))
""",
        tmp_path,
    )
    assert done.stderr == ""
    assert done.stdout.split("\n")[:3] == ["locked", "locked", "q ['lock', 'reserve']"]


def test_windows_owns_output_folders_and_exchanges_rigs(tmp_path):
    done = run_on_windows(
        f"""
from beltscape.cli.main import main
rig = {str(DEMO / "truth" / "rig.json")!r}
assert main(["export", rig, "--format", "ros", "--out", "ros"]) == 0
assert main(["import", "ros", "--out", "back.json"]) == 0
assert main(["export", rig, "--format", "ros", "--out", "ros"]) == 0
""",
        tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "back.json").is_file()


@pytest.mark.skipif(
    not hasattr(os, "sched_setaffinity"), reason="this system does not bind processes to cores"
)
def test_processes_take_different_cores_and_free_them(tmp_path):
    code = "import os, sys, pathlib; "
    code += "from beltscape.core.system_calls import bind_to_free_core as bind; "
    code += "core = bind(pathlib.Path(sys.argv[1])); "
    code += "print(core, sorted(os.sched_getaffinity(0)), flush=True); input()"
    cores = sorted(os.sched_getaffinity(0))

    def start():
        process = subprocess.Popen(
            [sys.executable, "-c", code, tmp_path], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        return process, process.stdout.readline().strip()

    started = [start() for _ in range(len(cores) + 1)]
    assert [line for _, line in started] == [f"{core} [{core}]" for core in cores] + [f"None {cores}"]
    for process, _ in started:
        process.communicate("\n")
    last, line = start()
    last.communicate("\n")
    assert line == f"{cores[0]} [{cores[0]}]"


def find_posix_names(path: Path) -> set[str]:
    """Return the modules and attributes of `os` in a source file that Windows does not have."""
    text = path.read_text(encoding="utf-8")
    modules = re.findall(rf"^ *(?:import|from) ({'|'.join(POSIX_MODULES)})\b", text, re.MULTILINE)
    return {*modules, *re.findall(rf"\bos\.(?:{'|'.join(POSIX_CALLS)})\b", text)}


def test_no_other_module_calls_what_windows_lacks():
    source = Path(beltscape.__file__).parent
    allowed = {
        "core/system_calls.py": {
            "fcntl",
            "termios",
            "tty",
            "os.O_DIRECTORY",
            "os.getuid",
            "os.posix_fallocate",
            "os.sched_getaffinity",
            "os.statvfs",
            "os.sync",
        },
        "sources/fake_genicam/camera.py": {"fcntl"},  # Aravis, which simulates cameras, is Linux's
    }
    found = {str(path.relative_to(source)): find_posix_names(path) for path in source.rglob("*.py")}
    assert {name: names for name, names in found.items() if names} == allowed


def test_a_process_uses_no_more_cores_than_it_was_given(monkeypatch):
    monkeypatch.delenv(CORES, raising=False)
    cores = count_usable_cores()
    for given, expected in (("1", 1), ("1000", cores), ("", cores)):
        monkeypatch.setenv(CORES, given)
        assert count_usable_cores() == expected
    for wrong in ("0", "-1", "two", "1.5", "²"):
        monkeypatch.setenv(CORES, wrong)
        with pytest.raises(SettingsError, match=f"BELTSCAPE_CORES={wrong}: must be"):
            count_usable_cores()


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc keeps freed memory")
def test_freed_memory_goes_back_to_the_system():
    code = """
from pathlib import Path
from beltscape.core.system_calls import release_memory
def resident_mib():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 2**20
blocks = [bytearray(16 << 10) for _ in range(10_000)]
blocks = blocks[::100]  # holes between those that stay
before = resident_mib()
release_memory()
print(before - resident_mib())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert float(done.stdout) > 100
