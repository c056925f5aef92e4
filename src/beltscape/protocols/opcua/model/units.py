"""Engineering units with the codes of UNECE Recommendation 20, as OPC UA states units (OPC 10000-8)."""

from __future__ import annotations

from asyncua import ua

_URI = "http://www.opcfoundation.org/UA/units/un/cefact"
_CODES: dict[str, tuple[str, str]] = {
    "m³/h": ("MQH", "cubic metre per hour"),
    "t/h": ("E18", "tonne per hour"),
    "m/s": ("MTS", "metre per second"),
    "m²": ("MTK", "square metre"),
    "kg/m": ("KL", "kilogram per metre"),
    "m³": ("MTQ", "cubic metre"),
    "t": ("TNE", "tonne"),
    "m": ("MTR", "metre"),
    "mm": ("MMT", "millimetre"),
    "kg": ("KGM", "kilogram"),
    "l": ("LTR", "litre"),
    "%": ("P1", "percent"),
}
"""Unit → common code of UNECE Recommendation 20, and name."""


def make_unit(unit: str) -> ua.EUInformation:
    """Return a unit; the identifier is its code's characters as one number."""
    code, name = _CODES[unit]
    identifier = int.from_bytes(code.encode("ascii"), "big")
    return ua.EUInformation(_URI, identifier, ua.LocalizedText(unit), ua.LocalizedText(name))
