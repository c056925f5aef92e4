"""What can be wrong with a request before anybody looks at what it wants."""

from __future__ import annotations

import ipaddress
import re
import socket
from collections.abc import Mapping

UNSAFE = frozenset({"POST", "PUT", "PATCH", "DELETE"})
METHODS = UNSAFE | {"GET", "HEAD", "OPTIONS"}
HEADERS_MAX, HEADERS_MAX_BYTES = 100, 16_384
"""Most headers, and longest all of them; the connection's own limit holds only for what comes in pieces."""
TARGET_MAX = 4096
"""Longest path and query together, bytes."""
_NAME = re.compile(r"(?P<name>\[[0-9a-fA-F:.]{2,45}\]|[A-Za-z0-9._-]{1,253})(?::\d{1,5})?")


def host_allowed(host: str, names: frozenset[str]) -> bool:
    """Whether a browser may have called the service by this Host header.

    IP addresses always, since no foreign name server can point one elsewhere (DNS rebinding); else ``names``.
    """
    found = _NAME.fullmatch(host)
    if found is None:
        return False
    name = found["name"].lower().rstrip(".")
    if name in names:
        return True
    try:
        ipaddress.ip_address(name.strip("[]"))
    except ValueError:
        return False
    return True


def own_names(allowed: tuple[str, ...]) -> frozenset[str]:
    """``allowed``, localhost and what this machine calls itself, in lower case."""
    return frozenset(n.lower().rstrip(".") for n in (*allowed, "localhost", socket.gethostname()))


def path_allowed(path: str, raw: bytes) -> bool:
    """Whether a path says plainly what it names.

    No way upwards, no empty or hidden part, no separator in disguise, nothing encoded twice, no control character.
    """
    if not path.startswith("/") or not path.isprintable() or any(c in path for c in "\\%\ufffd"):
        return False
    lowered = raw.lower()
    if b"%2f" in lowered or b"%5c" in lowered:
        return False
    parts = path[1:].split("/")
    return all(part and not part.startswith(".") for part in parts[:-1]) and not parts[-1].startswith(".")


def same_origin(headers: Mapping[str, str], scheme: str, *, unsafe: bool) -> bool:
    """Whether a request comes from the service's own page, or from no page at all.

    ``unsafe``: it may change something. Others may also be a link that somebody follows from elsewhere.
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
