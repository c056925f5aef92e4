"""Checks of a request's host, path and origin before any route handles it; pure functions."""

from __future__ import annotations

import ipaddress
import re
import socket
from collections.abc import Mapping

UNSAFE = frozenset({"POST", "PUT", "PATCH", "DELETE"})
METHODS = UNSAFE | {"GET", "HEAD", "OPTIONS"}
HEADERS_MAX, HEADERS_MAX_BYTES = 100, 16_384
"""Most headers, and their total length; the connection's own limit holds only for headers in several pieces."""
TARGET_MAX = 4096
"""Longest path and query together, bytes."""
_NAME = re.compile(r"(?P<name>\[[0-9a-fA-F:.]{2,45}\]|[A-Za-z0-9._-]{1,253})(?::\d{1,5})?")


def is_host_allowed(host: str, names: frozenset[str]) -> bool:
    """Return whether the Host header names this service.

    IP addresses are always allowed, since no foreign name server can redirect one (DNS rebinding); else ``names``.
    """
    match = _NAME.fullmatch(host)
    if match is None:
        return False
    name = match["name"].lower().rstrip(".")
    if name in names:
        return True
    try:
        ipaddress.ip_address(name.strip("[]"))
    except ValueError:
        return False
    return True


def list_own_names(allowed: tuple[str, ...]) -> frozenset[str]:
    """Return ``allowed``, localhost and this machine's own name, in lower case."""
    return frozenset(n.lower().rstrip(".") for n in (*allowed, "localhost", socket.gethostname()))


def is_path_allowed(path: str, raw: bytes) -> bool:
    """Return whether a path is plain.

    A plain path has no "..", no empty or hidden part, no encoded separator, no control character, no double encoding.
    """
    if not path.startswith("/") or not path.isprintable() or any(c in path for c in "\\%\ufffd"):
        return False
    lowered = raw.lower()
    if b"%2f" in lowered or b"%5c" in lowered:
        return False
    parts = path[1:].split("/")
    return all(part and not part.startswith(".") for part in parts[:-1]) and not parts[-1].startswith(".")


def is_same_origin(headers: Mapping[str, str], scheme: str, *, unsafe: bool) -> bool:
    """Return whether a request comes from the service's own page, or from no page at all.

    ``unsafe``: the request may change something. Other requests may also follow a link from another site.
    """
    own = f"{ {'ws': 'http', 'wss': 'https'}.get(scheme, scheme) }://{headers.get('host', '')}"
    origin, site = headers.get("origin"), headers.get("sec-fetch-site")
    if origin is not None and origin.lower() != own.lower():
        return False
    if site in (None, "same-origin"):
        return True
    if unsafe:
        return False
    return site == "none" or headers.get("sec-fetch-mode") == "navigate"
