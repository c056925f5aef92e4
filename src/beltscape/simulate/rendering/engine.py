"""Mitsuba's engines: `scalar` is always available; `llvm` compiles the scene and needs LLVM 19 or later."""

from __future__ import annotations

from typing import Any, Literal, cast

from beltscape.core.errors import SettingsError

Engine = Literal["scalar", "llvm", "auto"]
_VARIANTS = {"scalar": "scalar_rgb", "llvm": "llvm_ad_rgb"}
_OLDEST_LLVM = 19
"""LLVM 15 aborts the process during a compilation ("Cannot select fminimum"); 19 renders the tests' scenes."""


def load_mitsuba(engine: Engine) -> Any:
    """Return Mitsuba with its variant set.

    Raises
    ------
    SettingsError
        If `llvm` is requested and LLVM is not installed.
    """
    import mitsuba as mi

    mi.set_variant(_VARIANTS[resolve_engine(engine)])
    return mi


def resolve_engine(engine: Engine) -> Literal["scalar", "llvm"]:
    """Return the engine that renders; ``auto`` is `llvm` where LLVM is installed, else `scalar`.

    Raises
    ------
    SettingsError
        If `llvm` is requested and LLVM is not installed.
    """
    if engine == "scalar":
        return "scalar"
    version = _llvm_version()
    if engine == "llvm" and version < _OLDEST_LLVM:
        installed = f"finds LLVM {version}" if version >= 0 else "finds none"
        raise SettingsError(
            f"the engine llvm needs LLVM's shared library, version {_OLDEST_LLVM} or later, and {installed}; "
            "install it, set DRJIT_LIBLLVM_PATH, or choose scalar"
        )
    return "llvm" if version >= _OLDEST_LLVM else "scalar"


def _llvm_version() -> int:
    """Return the major version of the LLVM that Dr.Jit finds, -1 where it finds none."""
    import drjit

    previous_level = drjit.log_level()
    drjit.set_log_level(drjit.LogLevel.Disable)  # a missing LLVM is no error here
    try:
        return int(
            cast(Any, drjit.detail).llvm_version()[0]
        )  # drjit does not say what the version is made of
    finally:
        drjit.set_log_level(previous_level)
