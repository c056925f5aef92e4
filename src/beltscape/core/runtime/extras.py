"""The extras of the package: which install brings the libraries that only some commands need."""

from __future__ import annotations

EXTRAS = {
    "simulate": ("drjit", "embreex", "mitsuba"),
    "live": ("fastapi", "prometheus_client", "pyarrow", "starlette", "uvicorn", "websockets"),
    "site": ("httpx",),
    "modbus": ("pymodbus",),
    "mqtt": ("paho", "google"),
    "reports": ("weasyprint",),
    "opcua": ("asyncua", "cryptography"),
    "cluster": ("ray", "s3fs"),
    "viewer": ("rerun",),
    "export": ("laspy", "lazrs"),
    "cameras": ("gi",),
}
"""Extra of pyproject.toml → its libraries by the names under which they are imported."""


def describe_missing_library(error: ImportError) -> str | None:
    """Return what to install for a library that is missing; None if it belongs to no extra."""
    library = (error.name or "").partition(".")[0]
    for extra, libraries in EXTRAS.items():
        if library in libraries:
            return f"this needs {library}, which is not installed; run: pip install 'beltscape[{extra}]'"
    return None
