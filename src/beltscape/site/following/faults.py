"""Faults of a belt in one line each; the page has the same texts in all languages by their keys."""

from __future__ import annotations

from dataclasses import dataclass, field

TEXTS = {
    "unreachable": "{url}: cannot be reached ({reason}); is the machine on, and is the address right?",
    "timeout": "{url}: does not answer in time; the machine or the network is overloaded",
    "certificate": "{url}: its certificate is refused ({reason}); give its authority as ca, and its own host name",
    "not_tls": "{url}: does not speak TLS; give its address with http://, or give that machine a certificate",
    "needs_tls": "{url}: closes the connection; if that machine has a certificate, give its address with https://",
    "key": "{url}: does not know the key; make one there by `beltscape users key`, and write it into key_file",
    "host": "{url}: refuses this host name; list it there in [web.access] allowed_hosts",
    "busy": "{url}: answers too many requests already; it is asked again in {wait_s:.0f} s",
    "history": "{url}: cannot read its history at the moment; see its own alarms",
    "status": "{url}: answers with status {status}; is the address that of a belt's page?",
    "foreign": "{url}: answers, but not as a belt does ({reason}); is the address that of a belt's page?",
    "version": "runs version {version}, this site {own}; update both, if something is missing here",
    "clock": "its clock differs by {offset_s:.0f} s from this machine's; synchronise both (NTP); it is in no balance",
    "replaced": "its ledger was replaced: record {number} is another now; records later than it count",
    "pruned": "its ledger no longer holds the records {first} to {last}; they are in no sum of this site",
    "store": "its sums cannot be written ({reason}); free the disk of the site's machine",
    "no_frames": "sends no frames for {age_s:.0f} s; see its own page",
}
"""Key → the fault and its fix, in English."""
ALARMS = ("clock", "replaced", "pruned", "no_frames", "store")
"""Faults of a belt that answers, which are alarms of the site; the others are one once the belt counts as away."""


@dataclass(frozen=True, slots=True)
class Fault:
    """Something wrong with a belt."""

    key: str
    """One of TEXTS."""
    values: dict[str, float | int | str] = field(default_factory=dict[str, "float | int | str"])

    @property
    def text(self) -> str:
        """Return the fault and its fix in one line."""
        return TEXTS[self.key].format(**self.values)


class BeltFaultError(Exception):
    """A belt's machine cannot be read; ``wait_s``: the least time until it is asked again."""

    def __init__(self, fault: Fault, wait_s: float = 0.0) -> None:
        super().__init__(fault.text)
        self.fault, self.wait_s = fault, wait_s
