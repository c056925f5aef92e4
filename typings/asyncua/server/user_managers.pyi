from typing import Any

from asyncua.crypto.permission_rules import User
from asyncua.server.internal_server import InternalServer

class UserManager:
    def get_user(
        self,
        iserver: InternalServer,
        username: str | None = None,
        password: str | None = None,
        certificate: Any = None,
    ) -> User | None: ...
