from typing import Any

from asyncua.server.internal_session import InternalSession

class EventGenerator:
    event: Any
    def __init__(self, isession: InternalSession) -> None: ...
    async def init(self, etype: int) -> None: ...
