"""Request bodies of /api/access."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends
from pydantic import BaseModel, ConfigDict, Field

from beltscape.service.access.identity.passwords import MAX_LENGTH
from beltscape.service.access.identity.roles import Role, User
from beltscape.service.access.requests.dependencies import require_role

Name = Annotated[str, Field(min_length=1, max_length=64)]
Password = Annotated[str, Field(min_length=1, max_length=MAX_LENGTH)]
Viewer = Annotated[User, Depends(require_role("viewer"))]
Engineer = Annotated[User, Depends(require_role("engineer"))]


class _Body(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Credentials(_Body):
    """Name and password of a login."""

    name: Name
    password: Password


class FirstEngineer(Credentials):
    """The engineer that the setup creates."""

    token: Annotated[str, Field(min_length=1, max_length=64)]
    """Setup token that the program printed at its start."""


class NewPassword(_Body):
    """A change of one's own password."""

    old: Password
    new: Password


class NewUser(Credentials):
    """A user to add."""

    role: Role


class Changes(_Body):
    """Changes of a user; fields left out stay as they are."""

    role: Role | None = None
    password: Password | None = None
