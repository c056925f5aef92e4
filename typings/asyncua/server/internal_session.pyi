from collections.abc import Callable
from typing import Any

from asyncua import ua
from asyncua.crypto.permission_rules import User

class InternalSession:
    name: tuple[str, int] | str
    user: User
    iserver: Any
    def __init__(
        self,
        internal_server: object,
        aspace: object,
        submgr: object,
        name: Any,
        user: User = ...,
        external: bool = False,
    ) -> None: ...
    def is_activated(self) -> bool: ...
    async def create_session(
        self, params: ua.CreateSessionParameters, sockname: tuple[str, int] | None = None
    ) -> ua.CreateSessionResult: ...
    def activate_session(
        self, params: ua.ActivateSessionParameters, peer_certificate: bytes | None
    ) -> ua.ActivateSessionResult: ...
    async def close_session(self, delete_subs: bool = True) -> None: ...
    async def call(self, params: list[ua.CallMethodRequest]) -> list[ua.CallMethodResult]: ...
    def add_method_callback(self, methodid: ua.NodeId, callback: Callable[..., object]) -> ua.StatusCode: ...
