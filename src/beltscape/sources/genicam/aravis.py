"""Access to the Aravis library, and discovery of cameras on the network."""

from __future__ import annotations

from dataclasses import dataclass
from ipaddress import AddressValueError, IPv4Address
from typing import TYPE_CHECKING, Any

from beltscape.core.errors import InputError, SettingsError

if TYPE_CHECKING:
    from gi.repository import GLib


def load_aravis() -> Any:
    """Return the module ``gi.repository.Aravis``; SettingsError with the packages to install if it is missing."""
    try:
        import gi

        gi.require_version("Aravis", "0.8")
        from gi.repository import Aravis
    except (ImportError, ValueError) as error:
        raise SettingsError(
            f"cameras: Aravis cannot be used ({error}); install Debian's gir1.2-aravis-0.8, libgirepository1.0-dev "
            "and libcairo2-dev, then: pip install 'beltscape[cameras]'"
        ) from error
    return Aravis


def glib_error_type() -> type[GLib.Error]:
    """Return the exception type that Aravis's calls raise; call ``load_aravis()`` first."""
    from gi.repository import GLib

    return GLib.Error


@dataclass(frozen=True, slots=True)
class FoundCamera:
    """A camera that answers on the network."""

    device: str
    """Its id, such as "Basler-21730563"."""
    model: str
    maker: str
    address: str
    serial: str
    protocol: str


def find_cameras() -> list[FoundCamera]:
    """Return the cameras that answer now, sorted by address; takes about a second."""
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
    return sorted(cameras, key=lambda camera: (_address_number(camera.address), camera.device))


def _address_number(address: str) -> int:
    try:
        return int(IPv4Address(address))
    except AddressValueError:
        return 0


def resolve_device(device: str) -> str:
    """Return the name by which Aravis opens a camera: an address as it is, the id for an id or a serial number.

    InputError unless exactly one camera has that id or serial number.
    """
    if _address_number(device):
        return device
    cameras = find_cameras()
    matching = [camera for camera in cameras if device in (camera.device, camera.serial)]
    if not matching:
        names = ", ".join(f"{camera.device} ({camera.address})" for camera in cameras) or "none"
        raise InputError(f"no camera {device} answers; there are: {names}")
    if len(matching) > 1:
        raise InputError(f"more than one camera has the serial number {device}; give its id or address")
    return matching[0].device
