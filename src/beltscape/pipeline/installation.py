"""The checks of ``beltscape doctor``: what is installed, and whether the machine suits the job.

Software: versions, kernels, extras, camera library, browser. Machine: speed of matching, network cards, socket
buffers, disk, clock, graphics processor.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter, process_time

from beltscape import __version__
from beltscape.core.errors import EXTRAS, BeltscapeError
from beltscape.core.system_calls import count_usable_cores


@dataclass(frozen=True, slots=True)
class InstallationCheck:
    """One line of ``beltscape doctor``."""

    name: str
    found: str
    """What is there, in one line."""
    fix: str = ""
    """What to do; empty: it is good as it is."""

    @property
    def state(self) -> str:
        """Either "ok", or "warning" where there is something to do."""
        return "warning" if self.fix else "ok"


_LEVELS = {"v2": "SSE 4.2", "v3": "AVX2", "v4": "AVX-512", "base": "the compiler's default"}
"""Instruction-set level of x86-64 → its vector instructions."""
_BROWSERS = ("chromium", "google-chrome", "firefox", "chrome", "msedge")


def check_software() -> Iterator[InstallationCheck]:
    """Yield the checks of the software, from the program to the browser."""
    package = Path(__file__).resolve().parents[1]
    python = f"Python {platform.python_version()} ({sys.executable})"
    yield InstallationCheck("beltscape", f"{__version__} in {package}, {python}")
    yield check_kernels()
    yield check_threads()
    yield from check_extras()
    yield check_camera_library()
    yield check_browser()
    yield check_printing()


def check_kernels() -> InstallationCheck:
    """Return which level of the kernels is used, and which ones this processor runs."""
    from beltscape.kernels import load
    from beltscape.kernels.native import levels

    try:
        built, name = levels(), load().name
    except BeltscapeError as error:
        return InstallationCheck(
            "kernels", str(error), "install beltscape anew: pip install --force-reinstall beltscape"
        )
    found = f"{name} ({_LEVELS.get(name, 'plain NumPy')}); this processor runs {', '.join(built)}"
    if name == "cuda":
        from beltscape.kernels import kernels_on_gpu

        on_gpu = (
            f"cuda for {', '.join(kernels_on_gpu())}; {built[-1]} ({_LEVELS.get(built[-1])}) for the others"
        )
        return InstallationCheck("kernels", on_gpu)
    if name == built[-1]:
        return InstallationCheck("kernels", found)
    return InstallationCheck("kernels", found, f"unset BELTSCAPE_KERNELS to use {built[-1]}, which is faster")


def check_threads() -> InstallationCheck:
    """Return how many processor cores this process may use."""
    present = os.cpu_count() or 1
    usable = count_usable_cores()
    found = f"{usable} of {present} processor cores may be used"
    if usable >= min(present, 2):
        return InstallationCheck("threads", found)
    return InstallationCheck(
        "threads", found, "lift the limit of the service or the container; five cameras need two"
    )


def check_extras() -> Iterator[InstallationCheck]:
    """Yield for each extra of the package whether its libraries are installed."""
    for extra, libraries in EXTRAS.items():
        if extra in (
            "cameras",
            "gpu",
        ):  # they need more than a library: `check_camera_library`, `check_graphics`
            continue
        absent = [name for name in libraries if find_spec(name) is None]
        if not absent:
            yield InstallationCheck(extra, "installed")
        else:
            yield InstallationCheck(
                extra, f"{', '.join(absent)} not installed", f"pip install 'beltscape[{extra}]'"
            )


def check_camera_library() -> InstallationCheck:
    """Return whether Aravis, the library of GenICam cameras, can be used."""
    from beltscape.sources.genicam.aravis import load_aravis

    try:
        load_aravis()
    except BeltscapeError as error:
        return InstallationCheck("cameras", "no camera library", str(error).partition("; ")[2])
    return InstallationCheck("cameras", "Aravis 0.8 is installed; beltscape cameras lists what answers")


def check_browser() -> InstallationCheck:
    """Return whether a browser is installed here; reports and the page open in any other machine's as well."""
    found = next((path for name in _BROWSERS if (path := shutil.which(name))), None)
    if found:
        return InstallationCheck("browser", found)
    return InstallationCheck(
        "browser", "none on this machine; reports and the page open in another machine's browser"
    )


def check_printing() -> InstallationCheck:
    """Return whether reports can be handed to a printer; `beltscape run --check` asks for the printer itself."""
    found = [shutil.which(name) for name in ("lp", "lpstat")]
    if None not in found:
        return InstallationCheck("printing", f"CUPS by {found[0]}")
    return InstallationCheck(
        "printing", "no lp here; reports are printed from another machine, or after: apt install cups-client"
    )


JUMBO_MTU = 9000
"""Usual largest packet of GigE Vision; with 1500 a camera sends six times as many packets."""
RECEIVE_BUFFER = 33_554_432
"""Bytes that deploy/sysctl.conf sets: five images of 2448×2048 and their packets."""
_LEAST_MB_S = 100.0
"""A day's records take kilobytes a second; recording five cameras of 1224×1024 at 8 frames/s takes 50 MB/s."""
_WRITE_MB = 64
"""MiB that are written to measure the disk: more than a disk's own cache, and done in a second."""
_LEAST_FREE_GB = 10.0
"""Half a year of records, or three minutes of recorded images."""


def check_machine(folder: Path) -> Iterator[InstallationCheck]:
    """Yield the checks of the machine; the disk is that of ``folder``."""
    yield check_speed()
    yield from check_network_cards(Path("/sys/class/net"))
    yield check_socket_buffers(Path("/proc/sys/net/core/rmem_max"))
    yield check_disk(folder)
    yield check_clock()
    yield check_graphics()


_DEMO_RANGE_MM = 570.0, 750.0
"""Depth range of the demo capture's belt and load (`data/demo`)."""


def check_speed() -> InstallationCheck:
    """Return how many frame sets the cores match in a second, by the demo's: 612 × 512 px, five cameras."""
    from beltscape.core.progress import Silent
    from beltscape.files.capture import DEMO_FOLDER
    from beltscape.files.rig_json import read_rig
    from beltscape.pipeline.reconstructing.reconstruction import open_capture
    from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
    from beltscape.stereo.settings import MultiviewSettings

    rig = read_rig(DEMO_FOLDER / "truth" / "rig.json")
    frames = next(iter(open_capture(DEMO_FOLDER / "belt_loaded", rig, Silent())))
    settings = MultiviewSettings.preset("fast").model_copy(update={"threads": 1})
    matcher = MultiviewReconstructor(rig, _DEMO_RANGE_MM, settings)
    began_s = process_time()
    matcher.reconstruct(frames, Silent())
    seconds, cores = process_time() - began_s, count_usable_cores()
    width_px, height_px = rig.core_camera.size_px
    found = (
        f"{seconds:.2g} s of a core for a frame set of {len(rig.cameras)} cameras, {width_px}×{height_px} px, fast: "
        f"{cores} cores match {cores / seconds:.2g} a second"
    )
    return InstallationCheck("matching", found)


def check_network_cards(folder: Path) -> Iterator[InstallationCheck]:
    """Yield for each physical network card that is up whether it takes the cameras' large packets."""
    for card in sorted(folder.iterdir()) if folder.is_dir() else ():
        with suppress(OSError, ValueError):
            if card.name == "lo" or (card / "operstate").read_text().strip() != "up":
                continue
            mtu = int((card / "mtu").read_text())
            fix = (
                ""
                if mtu >= JUMBO_MTU
                else f"if cameras hang on it: ip link set {card.name} mtu {JUMBO_MTU}, and the same on the switch"
            )
            yield InstallationCheck(f"network {card.name}", f"packets up to {mtu} bytes", fix)


def check_socket_buffers(limit: Path) -> InstallationCheck:
    """Return whether images of all cameras fit into the socket buffers while the program is busy."""
    try:
        size = int(limit.read_text())
    except (OSError, ValueError):
        fix = f"for GigE cameras: see that a socket may have {RECEIVE_BUFFER} bytes"
        return InstallationCheck("socket buffers", "not known on this system", fix)
    found = f"up to {size / 2**20:.1f} MiB"
    if size >= RECEIVE_BUFFER:
        return InstallationCheck("socket buffers", found)
    return InstallationCheck(
        "socket buffers",
        found,
        f"for GigE cameras: sysctl -w net.core.rmem_max={RECEIVE_BUFFER}, deploy/sysctl.conf",
    )


def check_disk(folder: Path) -> InstallationCheck:
    """Return free space and measured writing speed of the disk that holds ``folder``."""
    place = next(path for path in (folder, *folder.absolute().parents) if path.is_dir())
    free_gb = shutil.disk_usage(place).free / 1e9
    try:
        speed = _measure_writing_mb_s(place)
    except OSError as error:
        return InstallationCheck(
            "disk", f"{place}: {error.strerror or error}", "give a folder that can be written"
        )
    found = f"{place}: {free_gb:.0f} GB free, writes {speed:.0f} MB/s"
    if free_gb < _LEAST_FREE_GB:
        return InstallationCheck(
            "disk", found, f"free some space; half a year of records needs {_LEAST_FREE_GB:.0f} GB"
        )
    if speed < _LEAST_MB_S:
        return InstallationCheck(
            "disk", found, "records fit, but images cannot be recorded at full rate; use an SSD"
        )
    return InstallationCheck("disk", found)


def _measure_writing_mb_s(folder: Path) -> float:
    """Return the speed of writing through to the disk, MB/s."""
    block = os.urandom(2**20)
    with tempfile.TemporaryFile(dir=folder) as file:
        began = perf_counter()
        for _ in range(_WRITE_MB):
            file.write(block)
        file.flush()
        os.fsync(file.fileno())
        return _WRITE_MB * 2**20 / 1e6 / max(perf_counter() - began, 1e-6)


def check_clock() -> InstallationCheck:
    """Return whether the system's clock is synchronised; records carry its time."""
    answer = _run_program("timedatectl", "show", "--property=NTPSynchronized", "--value")
    if answer is None:
        fix = "timedatectl does not answer; records carry this clock's time: see that NTP or PTP sets it"
        return InstallationCheck("clock", "not known whether it is synchronised", fix)
    if answer == "yes":
        return InstallationCheck("clock", "synchronised")
    return InstallationCheck(
        "clock", "not synchronised", "timedatectl set-ntp true, or a PTP clock beside the cameras"
    )


def check_graphics() -> InstallationCheck:
    """Return the graphics processor; none is needed."""
    answer = _run_program(
        "nvidia-smi", "--query-gpu=name,memory.total,driver_version", "--format=csv,noheader"
    )
    if not answer:
        return InstallationCheck("GPU", "none; none is needed")
    missing = [name for name in EXTRAS["gpu"] if find_spec(name) is None]
    fix = "to compute on it: pip install 'beltscape[gpu]'" if missing else ""
    return InstallationCheck("GPU", answer.splitlines()[0], fix)


def _run_program(*words: str) -> str | None:
    """Return what a program prints; None without it, or if it fails."""
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()
