"""The exceptions that Beltscape raises, as a tree, and the install that brings a library that is missing.

BeltscapeError
├── InputError         a file, folder or value given by the user does not fit
│   └── ArgumentError  a type cannot hold a value that was given to it; also a ValueError
├── OutputError        a result cannot be written to the requested place
├── CalibrationError   the images do not determine a rig
├── ReconstructionError  the frame does not yield a surface
├── MeasureError       the surface does not yield the quantity
├── SettingsError      a setting is unknown or out of bounds
└── KernelError        arrays handed to a kernel do not fit, or no such kernel

Every message is one line that names the file, the value and the fix. Only the CLI turns it into an exit code.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable


_NEAR = 0.75
"""Least similarity (difflib) of a name to the one that was probably meant: a letter of four, two of eight. Chosen."""


def suggest_name(name: str, known: Iterable[str]) -> str:
    """Return "did you mean …?" with the known name that is really near, or else an empty text."""
    from difflib import get_close_matches

    near = get_close_matches(name, list(known), n=1, cutoff=_NEAR)
    return f"did you mean {near[0]}?" if near else ""


_PROGRAMMERS_WORDS = re.compile(
    r"could not convert|invalid literal|values to unpack|object (is not|has no)|index out of|codec can|pickle|=b['\"]"
)
"""What Python and NumPy say of values of another form, in words for programmers."""


def describe_cause(error: BaseException) -> str:
    """Return in one line of limited length, without Python's words, why a file or an answer cannot be used."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    if isinstance(error, UnicodeError):
        return "not UTF-8 text"
    if isinstance(error, KeyError):
        return f"{error.args[0] if error.args else 'a key'} is missing"
    text = " ".join(str(error).split())
    if isinstance(
        error, TypeError | AttributeError | IndexError | StopIteration
    ) or _PROGRAMMERS_WORDS.search(text):
        return "a part of it has another form"
    return text[:200] or "no reason is known"


class BeltscapeError(Exception):
    """Root of everything Beltscape raises on purpose."""


class InputError(BeltscapeError):
    """A file, folder or value given by the user does not fit."""


class ArgumentError(InputError, ValueError):
    """A value that was given to a type or function does not fit; the message names the argument."""


class OutputError(BeltscapeError):
    """A result cannot be written to the requested place."""


class CalibrationError(BeltscapeError):
    """The images do not determine a rig."""


class ReconstructionError(BeltscapeError):
    """The frame does not yield a surface."""


class MeasureError(BeltscapeError):
    """The surface does not yield the quantity."""


class SettingsError(BeltscapeError):
    """A setting is unknown or out of bounds."""


class KernelError(BeltscapeError):
    """Arrays handed to a kernel do not fit, or there is no such kernel."""


EXTRAS = {
    "simulate": ("drjit", "embreex", "mitsuba"),
    "live": ("fastapi", "prometheus_client", "pyarrow", "starlette", "uvicorn", "websockets"),
    "site": ("httpx",),
    "modbus": ("pymodbus",),
    "mqtt": ("paho", "google"),
    "reports": ("weasyprint",),
    "certificates": ("cryptography",),
    "opcua": ("asyncua",),
    "cluster": ("ray", "s3fs"),
    "viewer": ("rerun",),
    "export": ("laspy", "lazrs"),
    "cameras": ("gi",),
    "gpu": ("cuda",),
}
"""Extra of pyproject.toml → its libraries by the names under which they are imported."""


def describe_missing_library(error: ImportError) -> str | None:
    """Return what to install for a library that is missing; None if it belongs to no extra."""
    library = (error.name or "").partition(".")[0]
    for extra, libraries in EXTRAS.items():
        if library in libraries:
            return f"this needs {library}, which is not installed; run: pip install 'beltscape[{extra}]'"
    return None
