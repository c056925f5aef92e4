"""Checks of the software: versions, kernels, extras, camera library, browser."""

from __future__ import annotations

import os
import platform
import shutil
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

from beltscape import __version__
from beltscape.core.errors import BeltscapeError
from beltscape.core.runtime.extras import EXTRAS
from beltscape.core.runtime.system_calls import count_usable_cores
from beltscape.pipeline.installation.result import InstallationCheck

_LEVELS = {"v2": "SSE 4.2", "v3": "AVX2", "v4": "AVX-512", "base": "the compiler's default"}
"""Instruction-set level of x86-64 → its vector instructions."""
_BROWSERS = ("chromium", "google-chrome", "firefox", "chrome", "msedge")


def check_software() -> Iterator[InstallationCheck]:
    """Yield the checks of the software, from the program to the browser."""
    package = Path(__file__).resolve().parents[2]
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
        if extra == "cameras":  # they need more than a library: `check_camera_library`
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
    from beltscape.sources.genicam.access.aravis import load_aravis

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
