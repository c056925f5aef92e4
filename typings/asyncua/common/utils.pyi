from asyncua.ua import UaError

class ServiceError(UaError):
    code: int
    def __init__(self, code: int) -> None: ...
