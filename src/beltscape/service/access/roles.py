"""Who somebody is, and what that allows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Role = Literal["viewer", "operator", "engineer"]
"""viewer: looks; operator: also acknowledges and keeps recordings; engineer: also users and settings"""
ROLES: tuple[Role, ...] = ("viewer", "operator", "engineer")
"""From the least to the most; each may do what those before it may."""
ANONYMOUS = "anonymous"
"""Name of whoever has not logged in; no user may have it."""


@dataclass(frozen=True, slots=True)
class User:
    """Somebody who may come in."""

    name: str
    role: Role

    def may(self, role: Role) -> bool:
        """Whether this user may do what ``role`` may."""
        return ROLES.index(self.role) >= ROLES.index(role)
