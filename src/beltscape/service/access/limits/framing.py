"""Refusal of requests whose length is ambiguous (request smuggling, RFC 9112 sections 6.1 and 6.3).

h11 merges equal repetitions of Content-Length and prefers Transfer-Encoding where both are given, so the fields are
checked in the lines as received, before h11 reads them.
"""

from __future__ import annotations

from collections.abc import Sequence

from h11 import LocalProtocolError
from h11._receivebuffer import ReceiveBuffer


class StrictReceiveBuffer(ReceiveBuffer):
    """The receive buffer of a server's connection; it refuses ambiguous heads."""

    def maybe_extract_lines(self) -> list[bytearray] | None:
        """Return the lines of the next head, None if it is incomplete; LocalProtocolError if it is ambiguous."""
        lines = super().maybe_extract_lines()
        fault = find_framing_fault(lines or ())
        if fault:
            raise LocalProtocolError(fault, error_status_hint=400)  # h11 reports it as the remote's error
        return lines


def find_framing_fault(lines: Sequence[bytes | bytearray]) -> str:
    """Return why the length of a request with these lines is ambiguous; empty if it is not."""
    values: dict[bytes, list[bytes]] = {b"content-length": [], b"transfer-encoding": []}
    for line in lines:
        name, _, value = bytes(line).partition(b":")
        if name.strip().lower() in values:
            values[name.strip().lower()].append(value)
    lengths, codings = values.values()
    if lengths and codings:
        return "Content-Length and Transfer-Encoding together"
    if len(lengths) > 1 or any(b"," in value for value in lengths):
        return "Content-Length more than once"
    if len(codings) > 1:
        return "Transfer-Encoding more than once"
    if codings and lines[0].rstrip().endswith(b"HTTP/1.0"):
        return "Transfer-Encoding in HTTP/1.0"
    return ""
