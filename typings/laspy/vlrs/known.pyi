from laspy import VLR

class WktCoordinateSystemVlr(VLR):
    string: str
    def __init__(self, wkt_string: str = ...) -> None: ...
