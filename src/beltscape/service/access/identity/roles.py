"""Roles and users."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Role = Literal["viewer", "operator", "engineer"]
"""viewer: reads; operator: also acknowledges alarms, keeps recordings, begins maintenance; engineer: also sees the
system's checks and manages users"""
ROLES: tuple[Role, ...] = ("viewer", "operator", "engineer")
"""All roles, from least to most; each includes those before it."""
ANONYMOUS = "anonymous"
"""Name of users without a login; no account may have it."""


@dataclass(frozen=True, slots=True)
class User:
    """An identified user."""

    name: str
    role: Role

    def has_role(self, role: Role) -> bool:
        """Return whether the user's role includes ``role``."""
        return ROLES.index(self.role) >= ROLES.index(role)
