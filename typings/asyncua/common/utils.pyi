from asyncua.ua import UaError

class ServiceError(UaError):
    def __init__(self, code: int) -> None: ...
