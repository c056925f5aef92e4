"""Which of Mitsuba's engines renders: the plain one that is always there, or the one compiled through LLVM."""

from __future__ import annotations

import os
from typing import Any, Literal

from beltscape.core.errors import SettingsError

Engine = Literal["auto", "scalar", "llvm"]
ENVIRONMENT = "BELTSCAPE_RENDERER"
_VARIANTS = {"scalar": "scalar_rgb", "llvm": "llvm_ad_rgb"}
_LLVM_THAT_WORKS = (
    19  # LLVM 15 ends the whole process in the middle of a compilation ("Cannot select fminimum")
)


def mitsuba(engine: Engine = "auto") -> Any:
    """Mitsuba with its variant set; the environment's BELTSCAPE_RENDERER decides where ``engine`` is auto.

    Raises
    ------
    SettingsError
        If the engine is unknown, or LLVM is asked for and is not there.
    """
    import mitsuba as mi

    mi.set_variant(_VARIANTS[chosen(engine)])
    return mi


def chosen(engine: Engine = "auto") -> Literal["scalar", "llvm"]:
    """The engine that will be used."""
    wanted = os.environ.get(ENVIRONMENT, "auto") if engine == "auto" else engine
    if wanted == "scalar":
        return "scalar"
    if wanted not in ("auto", "llvm"):
        raise SettingsError(f"{ENVIRONMENT} = {wanted!r}: no such engine; choose auto, scalar or llvm")
    version = _llvm_version()
    if wanted == "llvm" and version < 0:
        raise SettingsError(
            "the engine llvm needs LLVM's shared library, which is not found; "
            f"install LLVM {_LLVM_THAT_WORKS}, set DRJIT_LIBLLVM_PATH, or choose scalar"
        )
    return "llvm" if wanted == "llvm" or version >= _LLVM_THAT_WORKS else "scalar"


def _llvm_version() -> int:
    """Major version of the LLVM that Dr.Jit finds, -1 where it finds none."""
    import drjit

    before = drjit.log_level()
    drjit.set_log_level(drjit.LogLevel.Disable)  # no LLVM is nothing to complain about
    try:
        return int(drjit.detail.llvm_version()[0])
    finally:
        drjit.set_log_level(before)
