"""Types of OpenCV's ArUco module, as far as this project uses it."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

CORNER_REFINE_NONE: int
DICT_5X5_50: int

class Dictionary:
    bytesList: NDArray[np.uint8]
    markerSize: int
    maxCorrectionBits: int
    def __init__(self, bytesList: NDArray[np.uint8], _markerSize: int, maxcorr: int = ...) -> None: ...
    def generateImageMarker(
        self, id: int, sidePixels: int, *, borderBits: int = ...
    ) -> NDArray[np.uint8]: ...

def getPredefinedDictionary(dict: int) -> Dictionary: ...

class DetectorParameters:
    cornerRefinementMethod: int
    markerBorderBits: int

class CharucoParameters:
    tryRefineMarkers: bool

class CharucoBoard:
    def __init__(
        self,
        size: Sequence[int],
        squareLength: float,
        markerLength: float,
        dictionary: Dictionary,
        ids: NDArray[np.int32] = ...,
    ) -> None: ...
    def generateImage(
        self, outSize: Sequence[int], *, marginSize: int = ..., borderBits: int = ...
    ) -> NDArray[np.uint8]: ...
    def getChessboardCorners(self) -> Sequence[tuple[float, float, float]]: ...
    def getDictionary(self) -> Dictionary: ...
    def getIds(self) -> NDArray[np.int32]: ...
    def getObjPoints(self) -> Sequence[NDArray[np.float32]]: ...
    def setLegacyPattern(self, legacyPattern: bool) -> None: ...

class ArucoDetector:
    def __init__(self, dictionary: Dictionary, detectorParams: DetectorParameters = ...) -> None: ...
    def detectMarkers(
        self, image: NDArray[Any]
    ) -> tuple[Sequence[NDArray[np.float32]], NDArray[np.int32] | None, Sequence[NDArray[np.float32]]]: ...
    def refineDetectedMarkers(
        self,
        image: NDArray[Any],
        board: CharucoBoard,
        detectedCorners: Sequence[NDArray[np.float32]],
        detectedIds: NDArray[np.int32],
        rejectedCorners: Sequence[NDArray[np.float32]],
    ) -> tuple[
        Sequence[NDArray[np.float32]],
        NDArray[np.int32],
        Sequence[NDArray[np.float32]],
        NDArray[np.int32] | None,
    ]: ...

class CharucoDetector:
    def __init__(
        self,
        board: CharucoBoard,
        charucoParams: CharucoParameters = ...,
        detectorParams: DetectorParameters = ...,
    ) -> None: ...
    def detectBoard(
        self,
        image: NDArray[Any],
        *,
        markerCorners: Sequence[NDArray[np.float32]] = ...,
        markerIds: NDArray[np.int32] = ...,
    ) -> tuple[
        NDArray[np.float32] | None,
        NDArray[np.int32] | None,
        Sequence[NDArray[np.float32]],
        NDArray[np.int32] | None,
    ]: ...
