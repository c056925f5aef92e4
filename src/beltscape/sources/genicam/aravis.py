"""The Aravis library, where it is installed."""

from __future__ import annotations

from dataclasses import dataclass
from ipaddress import AddressValueError, IPv4Address
from typing import Any

from beltscape.core.errors import InputError, SettingsError


def load_aravis() -> Any:
    """The module ``gi.repository.Aravis``, or SettingsError that says what to install."""
    try:
        import gi  # pyright: ignore[reportMissingImports]

        gi.require_version("Aravis", "0.8")
        from gi.repository import Aravis  # pyright: ignore[reportMissingImports, reportAttributeAccessIssue]
    except (ImportError, ValueError) as error:
        raise SettingsError(
            f"cameras: Aravis cannot be used ({error}); install Debian's gir1.2-aravis-0.8, libgirepository1.0-dev "
            "and libcairo2-dev, then: pip install 'beltscape[cameras]'"
        ) from error
    return Aravis


def glib_error_type() -> type[Exception]:
    """What Aravis's calls raise; after ``load_aravis()``."""
    from gi.repository import GLib  # pyright: ignore[reportMissingImports, reportAttributeAccessIssue]

    return GLib.Error


@dataclass(frozen=True, slots=True)
class FoundCamera:
    """A camera on the network."""

    device: str
    """Its id, such as "Basler-21730563"."""
    model: str
    maker: str
    address: str
    serial: str
    protocol: str


def find_cameras() -> list[FoundCamera]:
    """The cameras that answer now, by address; takes a second."""
    lib = load_aravis()
    lib.update_device_list()
    cameras = [
        FoundCamera(
            lib.get_device_id(i) or "",
            lib.get_device_model(i) or "",
            lib.get_device_vendor(i) or "",
            lib.get_device_address(i) or "",
            lib.get_device_serial_nbr(i) or "",
            lib.get_device_protocol(i) or "",
        )
        for i in range(lib.get_n_devices())
    ]
    return sorted(cameras, key=lambda one: (_order(one.address), one.device))


def _order(address: str) -> int:
    try:
        return int(IPv4Address(address))
    except AddressValueError:
        return 0


def resolve_device(device: str) -> str:
    """What Aravis opens a camera by: an address as it is; for an id or serial number the id, looked for.

    InputError where no or more than one camera answers to it.
    """
    if _order(device):
        return device
    there = find_cameras()
    fitting = [one for one in there if device in (one.device, one.serial)]
    if not fitting:
        known = ", ".join(f"{one.device} ({one.address})" for one in there) or "none"
        raise InputError(f"no camera {device} answers; there are: {known}")
    if len(fitting) > 1:
        raise InputError(f"more than one camera has the serial number {device}; give its id or address")
    return fitting[0].device
