"""The users of the service and the provenance of its values, as a protocol with sign-in needs them."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.core.errors import BeltscapeError
from beltscape.pipeline.live.project import Project
from beltscape.protocols.plant import Provenance, UserRole
from beltscape.service.access import Access
from beltscape.service.access.identity.accounts import normalise_name


class NoUsers:
    """Nobody: a run without access."""

    def find_by_password(self, name: str, password: str, address: str) -> str | None:  # noqa: ARG002
        """Return None."""
        return None

    def has_role(self, user: str, role: UserRole) -> bool:  # noqa: ARG002
        """Return False."""
        return False

    def write_audit(self, action: str, user: str, address: str, detail: Mapping[str, str]) -> None:
        """Write nothing."""


class ServedUsers:
    """The users of the operator's page: one name and password for page and protocols, one throttle, one audit log."""

    def __init__(self, access: Access) -> None:
        self._access = access

    def find_by_password(self, name: str, password: str, address: str) -> str | None:
        """Return the user's stored name; None if name or password is wrong, or there were too many attempts.

        Attempts are counted together with those on the page; each costs some 0.1 s of a core, so they wait.
        """
        kept = normalise_name(name)
        if self._access.throttle.wait_s(kept, address) > 0:
            return None
        try:
            user = self._access.verify_login(name, password, address)
        except BeltscapeError:  # the users cannot be read: nobody enters
            return None
        return None if user is None else user.name

    def has_role(self, user: str, role: UserRole) -> bool:
        """Return whether there is that user, and its present role includes ``role``."""
        if not user:
            return False
        try:
            return self._access.accounts.find(user).has_role(role)
        except BeltscapeError:
            return False

    def write_audit(self, action: str, user: str, address: str, detail: Mapping[str, str]) -> None:
        """Add an entry to the audit log."""
        self._access.audit.write(action, user, address, dict(detail))


def describe_provenance(project: Project[Any]) -> Provenance:
    """Return what the values of a run come from: program, project, rig and belt, the last two by their hash."""
    from beltscape import __version__

    settings = project.settings
    files = {"Rig": project.resolve(settings.rig), "EmptyBelt": project.resolve(settings.empty)}
    texts = {"Program": f"beltscape {__version__}", "Project": str(project.path)}
    for key, path in files.items():
        texts[key] = path.name
        texts[f"{key}Sha256"] = _compute_hash(path)
    return texts


def _compute_hash(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""
