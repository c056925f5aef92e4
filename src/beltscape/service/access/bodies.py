"""What the requests of /api/access bring."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends
from pydantic import BaseModel, ConfigDict, Field

from beltscape.service.access.depends import needs
from beltscape.service.access.passwords import MOST
from beltscape.service.access.roles import Role, User

Name = Annotated[str, Field(min_length=1, max_length=64)]
Password = Annotated[str, Field(min_length=1, max_length=MOST)]
Viewer = Annotated[User, Depends(needs("viewer"))]
Engineer = Annotated[User, Depends(needs("engineer"))]


class _Body(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Credentials(_Body):
    """Who logs in."""

    name: Name
    password: Password


class FirstEngineer(Credentials):
    """Who is created at the setup."""

    token: Annotated[str, Field(min_length=1, max_length=64)]
    """What the program printed at its start."""


class NewPassword(_Body):
    """One's own password."""

    old: Password
    new: Password


class NewUser(Credentials):
    """A further user."""

    role: Role


class Changes(_Body):
    """What becomes different about a user; what is left out stays."""

    role: Role | None = None
    password: Password | None = None
