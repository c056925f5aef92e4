"""Types of the OpenCV functions that this project calls: arrays keep their element type.

OpenCV's own stub types every image as ``MatLike`` (any number, refuses None where OpenCV takes it), so that neither
an image's type nor an optional argument could be checked. Add a function here when the project first calls it.
"""

from collections.abc import Sequence
from os import PathLike
from typing import Any, Final, Literal, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from . import aruco as aruco
from . import utils as utils

_S = TypeVar("_S", bound=np.generic)
_Array = NDArray[Any]
_Scalar = float | Sequence[float]
_Point = Sequence[int]
_Size = Sequence[int]
_Criteria = tuple[int, int, float]

__version__: str

class error(Exception):
    code: int
    err: str
    file: str
    func: str
    line: int
    msg: str

class Error:
    StsNoConv: Final = -7

# constants ------------------------------------------------------------------------------------------------------
BORDER_CONSTANT: Final = 0
BORDER_REPLICATE: Final = 1
BORDER_REFLECT: Final = 2
BORDER_REFLECT_101: Final = 4
CALIB_CB_ADAPTIVE_THRESH: int
CALIB_CB_EXHAUSTIVE: int
CALIB_CB_FAST_CHECK: int
CALIB_CB_LARGER: int
CALIB_CB_NORMALIZE_IMAGE: int
CALIB_FIX_INTRINSIC: int
CALIB_FIX_K3: int
CALIB_RATIONAL_MODEL: int
CCL_BBDT: int
CC_STAT_AREA: int
CHAIN_APPROX_NONE: int
COLORMAP_VIRIDIS: int
COLOR_BayerGBRG2RGB: int
COLOR_BayerRGGB2RGB: int
COLOR_BayerRGGB2RGB_EA: int
COLOR_BayerRGGB2RGB_VNG: int
COLOR_GRAY2BGR: int
COLOR_RGB2BGR: int
COLOR_RGB2GRAY: int
CV_32F: Final = 5
CV_32S: Final = 4
CV_64F: Final = 6
DIST_L2: int
DIST_MASK_PRECISE: int
FILE_STORAGE_READ: int
FONT_HERSHEY_SIMPLEX: int
IMREAD_COLOR: int
IMREAD_UNCHANGED: int
IMWRITE_JPEG_QUALITY: int
IMWRITE_PNG_COMPRESSION: int
IMWRITE_TIFF_COMPRESSION: int
IMWRITE_WEBP_QUALITY: int
INTER_AREA: int
INTER_CUBIC: int
INTER_LANCZOS4: int
INTER_LINEAR: int
INTER_NEAREST: int
LINE_8: int
LINE_AA: int
LMEDS: int
MARKER_TILTED_CROSS: int
MORPH_CLOSE: int
MORPH_CROSS: int
MOTION_AFFINE: int
RANSAC: int
RETR_EXTERNAL: int
SOLVEPNP_SQPNP: int
STEREO_SGBM_MODE_SGBM: int
StereoSGBM_MODE_HH: int
StereoSGBM_MODE_SGBM: int
TERM_CRITERIA_COUNT: int
TERM_CRITERIA_EPS: int
TERM_CRITERIA_MAX_ITER: int
TM_CCOEFF_NORMED: int
WARP_INVERSE_MAP: int

# threads --------------------------------------------------------------------------------------------------------
def getNumThreads() -> int: ...
def setNumThreads(nthreads: int) -> None: ...

# files ----------------------------------------------------------------------------------------------------------
class Animation:
    frames: Sequence[NDArray[Any]]

def imdecode(buf: NDArray[np.uint8], flags: int) -> _Array | None: ...
def imdecodeanimation(buf: NDArray[np.uint8]) -> tuple[bool, Animation]: ...
def imencode(ext: str, img: _Array, params: Sequence[int] = ...) -> tuple[bool, NDArray[np.uint8]]: ...
def imread(filename: str | PathLike[str], flags: int = ...) -> _Array | None: ...
def imwrite(filename: str | PathLike[str], img: _Array, params: Sequence[int] = ...) -> bool: ...

class FileNode:
    def at(self, i: int) -> FileNode: ...
    def getNode(self, nodename: str) -> FileNode: ...
    def mat(self) -> _Array: ...
    def real(self) -> float: ...
    def size(self) -> int: ...
    def string(self) -> str: ...

class FileStorage:
    def __init__(self, filename: str, flags: int) -> None: ...
    def getNode(self, nodename: str) -> FileNode: ...

# filters --------------------------------------------------------------------------------------------------------
def getPerspectiveTransform(src: NDArray[np.float32], dst: NDArray[np.float32]) -> NDArray[np.float64]: ...
def warpPerspective(
    src: NDArray[_S],
    M: NDArray[np.float64],
    dsize: Sequence[int],
    *,
    flags: int = ...,
    borderValue: float = ...,
) -> NDArray[_S]: ...

class VideoCapture:
    def __init__(self, filename: str) -> None: ...
    def isOpened(self) -> bool: ...
    def read(self) -> tuple[bool, NDArray[np.uint8]]: ...
    def release(self) -> None: ...

class VideoWriter:
    def __init__(self, filename: str, fourcc: int, fps: float, frameSize: Sequence[int]) -> None: ...
    def isOpened(self) -> bool: ...
    def write(self, image: NDArray[np.uint8]) -> None: ...
    def release(self) -> None: ...

def VideoWriter_fourcc(c1: str, c2: str, c3: str, c4: str) -> int: ...
def Laplacian(src: NDArray[np.float32], ddepth: int) -> NDArray[np.float32]: ...
def getGaussianKernel(ksize: int, sigma: float) -> NDArray[np.float64]: ...
def GaussianBlur(
    src: NDArray[_S],
    ksize: _Size,
    sigmaX: float,
    dst: NDArray[_S] | None = ...,
    sigmaY: float = ...,
    borderType: int = ...,
) -> NDArray[_S]: ...
@overload
def Scharr(
    src: _Array, ddepth: Literal[6], dx: int, dy: int, *, scale: float = ..., borderType: int = ...
) -> NDArray[np.float64]: ...
@overload
def Scharr(
    src: _Array, ddepth: Literal[5], dx: int, dy: int, *, scale: float = ..., borderType: int = ...
) -> NDArray[np.float32]: ...
@overload
def Sobel(
    src: _Array,
    ddepth: Literal[6],
    dx: int,
    dy: int,
    *,
    ksize: int = ...,
    scale: float = ...,
    borderType: int = ...,
) -> NDArray[np.float64]: ...
@overload
def Sobel(
    src: _Array,
    ddepth: Literal[5],
    dx: int,
    dy: int,
    *,
    ksize: int = ...,
    scale: float = ...,
    borderType: int = ...,
) -> NDArray[np.float32]: ...
def blur(
    src: NDArray[_S],
    ksize: _Size,
    dst: NDArray[_S] | None = ...,
    anchor: _Point = ...,
    borderType: int = ...,
) -> NDArray[_S]: ...
@overload
def boxFilter(
    src: NDArray[_S],
    ddepth: Literal[-1],
    ksize: _Size,
    dst: NDArray[_S] | None = ...,
    anchor: _Point = ...,
    normalize: bool = ...,
    borderType: int = ...,
) -> NDArray[_S]: ...
@overload
def boxFilter(
    src: _Array,
    ddepth: Literal[5],
    ksize: _Size,
    dst: NDArray[np.float32] | None = ...,
    anchor: _Point = ...,
    normalize: bool = ...,
    borderType: int = ...,
) -> NDArray[np.float32]: ...
@overload
def boxFilter(
    src: _Array,
    ddepth: Literal[6],
    ksize: _Size,
    dst: NDArray[np.float64] | None = ...,
    anchor: _Point = ...,
    normalize: bool = ...,
    borderType: int = ...,
) -> NDArray[np.float64]: ...
def dilate(
    src: NDArray[_S],
    kernel: _Array | None,
    dst: NDArray[_S] | None = ...,
    anchor: _Point = ...,
    iterations: int = ...,
    borderType: int = ...,
    borderValue: _Scalar = ...,
) -> NDArray[_S]: ...
def erode(
    src: NDArray[_S],
    kernel: _Array | None,
    dst: NDArray[_S] | None = ...,
    anchor: _Point = ...,
    iterations: int = ...,
    borderType: int = ...,
    borderValue: _Scalar = ...,
) -> NDArray[_S]: ...
@overload
def filter2D(
    src: NDArray[_S],
    ddepth: Literal[-1],
    kernel: _Array,
    dst: NDArray[_S] | None = ...,
    anchor: _Point = ...,
    delta: float = ...,
    borderType: int = ...,
) -> NDArray[_S]: ...
@overload
def filter2D(
    src: _Array,
    ddepth: Literal[5],
    kernel: _Array,
    dst: NDArray[np.float32] | None = ...,
    anchor: _Point = ...,
    delta: float = ...,
    borderType: int = ...,
) -> NDArray[np.float32]: ...
def getStructuringElement(shape: int, ksize: _Size, anchor: _Point = ...) -> NDArray[np.uint8]: ...
def medianBlur(src: NDArray[_S], ksize: int, dst: NDArray[_S] | None = ...) -> NDArray[_S]: ...
def morphologyEx(
    src: NDArray[_S],
    op: int,
    kernel: _Array,
    dst: NDArray[_S] | None = ...,
    anchor: _Point = ...,
    iterations: int = ...,
    borderType: int = ...,
) -> NDArray[_S]: ...
@overload
def sepFilter2D(
    src: NDArray[_S],
    ddepth: Literal[-1],
    kernelX: _Array,
    kernelY: _Array,
    *,
    anchor: _Point = ...,
    delta: float = ...,
    borderType: int = ...,
) -> NDArray[_S]: ...
@overload
def sepFilter2D(
    src: _Array,
    ddepth: Literal[5],
    kernelX: _Array,
    kernelY: _Array,
    *,
    anchor: _Point = ...,
    delta: float = ...,
    borderType: int = ...,
) -> NDArray[np.float32]: ...

# resampling and colour ------------------------------------------------------------------------------------------
def applyColorMap(
    src: NDArray[np.uint8], colormap: int, dst: NDArray[np.uint8] | None = ...
) -> NDArray[np.uint8]: ...
def copyMakeBorder(
    src: NDArray[_S],
    top: int,
    bottom: int,
    left: int,
    right: int,
    borderType: int,
    dst: NDArray[_S] | None = ...,
    value: _Scalar = ...,
) -> NDArray[_S]: ...
def cvtColor(src: NDArray[_S], code: int, dst: NDArray[_S] | None = ..., dstCn: int = ...) -> NDArray[_S]: ...
def remap(
    src: NDArray[_S],
    map1: _Array,
    map2: _Array | None,
    interpolation: int,
    dst: NDArray[_S] | None = ...,
    borderMode: int = ...,
    borderValue: _Scalar = ...,
) -> NDArray[_S]: ...
def resize(
    src: NDArray[_S],
    dsize: _Size | None,
    dst: NDArray[_S] | None = ...,
    fx: float = ...,
    fy: float = ...,
    interpolation: int = ...,
) -> NDArray[_S]: ...
def warpAffine(
    src: NDArray[_S],
    M: _Array,
    dsize: _Size,
    dst: NDArray[_S] | None = ...,
    flags: int = ...,
    borderMode: int = ...,
    borderValue: _Scalar = ...,
) -> NDArray[_S]: ...

# arithmetic -----------------------------------------------------------------------------------------------------
def accumulateSquare(src: _Array, dst: NDArray[_S], mask: _Array | None = ...) -> NDArray[_S]: ...
def add(
    src1: NDArray[_S], src2: NDArray[_S] | _Scalar, dst: NDArray[_S] | None = ..., mask: _Array | None = ...
) -> NDArray[_S]: ...
def bitwise_not(
    src: NDArray[_S], dst: NDArray[_S] | None = ..., mask: _Array | None = ...
) -> NDArray[_S]: ...
def calcHist(
    images: Sequence[_Array],
    channels: Sequence[int],
    mask: _Array | None,
    histSize: Sequence[int],
    ranges: Sequence[float],
    hist: _Array | None = ...,
    accumulate: bool = ...,
) -> NDArray[np.float32]: ...
def meanStdDev(
    src: _Array, *, mask: _Array | None = ...
) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
def merge(mv: Sequence[NDArray[_S]], dst: NDArray[_S] | None = ...) -> NDArray[_S]: ...
def minMaxLoc(
    src: _Array, mask: _Array | None = ...
) -> tuple[float, float, tuple[int, int], tuple[int, int]]: ...
def multiply(
    src1: NDArray[_S], src2: NDArray[_S] | _Scalar, dst: NDArray[_S] | None = ..., scale: float = ...
) -> NDArray[_S]: ...
def patchNaNs(a: NDArray[_S], val: float = ...) -> NDArray[_S]: ...
def perspectiveTransform(
    src: NDArray[_S], m: NDArray[np.floating[Any]], dst: NDArray[_S] | None = ...
) -> NDArray[_S]: ...
def phaseCorrelate(
    src1: NDArray[_S], src2: NDArray[_S], window: _Array | None = ...
) -> tuple[tuple[float, float], float]: ...
def transform(src: NDArray[_S], m: _Array, dst: NDArray[_S] | None = ...) -> NDArray[_S]: ...

# regions --------------------------------------------------------------------------------------------------------
def arcLength(curve: _Array, closed: bool) -> float: ...
def connectedComponents(image: NDArray[np.uint8]) -> tuple[int, NDArray[np.int32]]: ...
def connectedComponentsWithStats(
    image: NDArray[np.uint8], *, connectivity: int = ...
) -> tuple[int, NDArray[np.int32], NDArray[np.int32], NDArray[np.float64]]: ...
def connectedComponentsWithStatsWithAlgorithm(
    image: NDArray[np.uint8], connectivity: int, ltype: int, ccltype: int
) -> tuple[int, NDArray[np.int32], NDArray[np.int32], NDArray[np.float64]]: ...
def contourArea(contour: _Array, oriented: bool = ...) -> float: ...
def convexHull(points: NDArray[_S], *, clockwise: bool = ...) -> NDArray[_S]: ...
def distanceTransform(src: NDArray[np.uint8], distanceType: int, maskSize: int) -> NDArray[np.float32]: ...
def filterSpeckles(
    img: NDArray[_S], newVal: float, maxSpeckleSize: int, maxDiff: float
) -> tuple[NDArray[_S], _Array]: ...
def findContours(
    image: NDArray[np.uint8], mode: int, method: int
) -> tuple[Sequence[NDArray[np.int32]], NDArray[np.int32] | None]: ...
def findNonZero(src: NDArray[np.uint8]) -> NDArray[np.int32]: ...
def minAreaRect(points: _Array) -> tuple[tuple[float, float], tuple[float, float], float]: ...

# features and matching ------------------------------------------------------------------------------------------
def cornerSubPix(
    image: _Array, corners: NDArray[np.float32], winSize: _Size, zeroZone: _Size, criteria: _Criteria
) -> NDArray[np.float32]: ...
def findChessboardCorners(
    image: NDArray[np.uint8], patternSize: _Size, corners: None = ..., flags: int = ...
) -> tuple[bool, NDArray[np.float32]]: ...
def findChessboardCornersSB(
    image: NDArray[np.uint8], patternSize: _Size, corners: None = ..., flags: int = ...
) -> tuple[bool, NDArray[np.float32]]: ...
def findChessboardCornersSBWithMeta(
    image: NDArray[np.uint8], patternSize: _Size, flags: int
) -> tuple[bool, NDArray[np.float32], NDArray[np.uint8]]: ...
def findTransformECC(
    templateImage: _Array,
    inputImage: _Array,
    warpMatrix: NDArray[np.float32],
    motionType: int,
    criteria: _Criteria,
    inputMask: _Array,
    gaussFiltSize: int,
) -> tuple[float, NDArray[np.float32]]: ...
def goodFeaturesToTrack(
    image: _Array,
    maxCorners: int,
    qualityLevel: float,
    minDistance: float,
    corners: None = ...,
    mask: NDArray[np.uint8] | None = ...,
    blockSize: int = ...,
) -> NDArray[np.float32] | None: ...
def matchTemplate(
    image: NDArray[_S], templ: NDArray[_S], method: int, *, mask: _Array | None = ...
) -> NDArray[np.float32]: ...

class StereoSGBM:
    @staticmethod
    def create(
        minDisparity: int = ...,
        numDisparities: int = ...,
        blockSize: int = ...,
        P1: int = ...,
        P2: int = ...,
        disp12MaxDiff: int = ...,
        preFilterCap: int = ...,
        uniquenessRatio: int = ...,
        speckleWindowSize: int = ...,
        speckleRange: int = ...,
        mode: int = ...,
    ) -> StereoSGBM: ...
    def compute(self, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> NDArray[np.int16]: ...

def StereoSGBM_create(
    minDisparity: int = ...,
    numDisparities: int = ...,
    blockSize: int = ...,
    P1: int = ...,
    P2: int = ...,
    disp12MaxDiff: int = ...,
    preFilterCap: int = ...,
    uniquenessRatio: int = ...,
    speckleWindowSize: int = ...,
    speckleRange: int = ...,
    mode: int = ...,
) -> StereoSGBM: ...

# geometry -------------------------------------------------------------------------------------------------------
def Rodrigues(src: NDArray[_S]) -> tuple[NDArray[_S], NDArray[_S]]: ...
def calibrateCamera(
    objectPoints: Sequence[NDArray[np.float32]],
    imagePoints: Sequence[NDArray[np.float32]],
    imageSize: _Size,
    cameraMatrix: NDArray[np.float64] | None,
    distCoeffs: NDArray[np.float64] | None,
    *,
    flags: int = ...,
    criteria: _Criteria = ...,
) -> tuple[
    float,
    NDArray[np.float64],
    NDArray[np.float64],
    Sequence[NDArray[np.float64]],
    Sequence[NDArray[np.float64]],
]: ...
def stereoCalibrate(
    objectPoints: Sequence[NDArray[np.float32]],
    imagePoints1: Sequence[NDArray[np.float32]],
    imagePoints2: Sequence[NDArray[np.float32]],
    cameraMatrix1: NDArray[np.float64],
    distCoeffs1: NDArray[np.float64],
    cameraMatrix2: NDArray[np.float64],
    distCoeffs2: NDArray[np.float64],
    imageSize: _Size,
    *,
    flags: int = ...,
    criteria: _Criteria = ...,
) -> tuple[
    float,
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
]: ...
def findHomography(
    srcPoints: _Array, dstPoints: _Array, method: int = ..., ransacReprojThreshold: float = ...
) -> tuple[NDArray[np.float64] | None, NDArray[np.uint8] | None]: ...
def projectPoints(
    objectPoints: NDArray[_S],
    rvec: _Array,
    tvec: _Array,
    cameraMatrix: _Array,
    distCoeffs: _Array | None,
) -> tuple[NDArray[_S], NDArray[np.float64]]: ...
def solvePnP(
    objectPoints: _Array,
    imagePoints: _Array,
    cameraMatrix: _Array,
    distCoeffs: _Array | None,
    *,
    flags: int = ...,
) -> tuple[bool, NDArray[np.float64], NDArray[np.float64]]: ...
def solvePnPRefineLM(
    objectPoints: _Array,
    imagePoints: _Array,
    cameraMatrix: _Array,
    distCoeffs: _Array | None,
    rvec: NDArray[np.float64],
    tvec: NDArray[np.float64],
    criteria: _Criteria = ...,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
def triangulatePoints(
    projMatr1: _Array, projMatr2: _Array, projPoints1: NDArray[_S], projPoints2: NDArray[_S]
) -> NDArray[_S]: ...
def undistortPoints(
    src: NDArray[_S],
    cameraMatrix: _Array,
    distCoeffs: _Array | None,
    *,
    R: _Array | None = ...,
    P: _Array | None = ...,
    criteria: _Criteria = ...,
) -> NDArray[_S]: ...

# drawing --------------------------------------------------------------------------------------------------------
class FontFace:
    def __init__(self, fontPathOrName: str = ...) -> None: ...

def circle(
    img: NDArray[_S],
    center: _Point,
    radius: int,
    color: _Scalar,
    thickness: int = ...,
    lineType: int = ...,
    shift: int = ...,
) -> NDArray[_S]: ...
def drawContours(
    image: NDArray[_S],
    contours: Sequence[_Array],
    contourIdx: int,
    color: _Scalar,
    thickness: int = ...,
    lineType: int = ...,
) -> NDArray[_S]: ...
def drawMarker(
    img: NDArray[_S],
    position: _Point,
    color: _Scalar,
    markerType: int = ...,
    markerSize: int = ...,
    thickness: int = ...,
    line_type: int = ...,
) -> NDArray[_S]: ...
def fillConvexPoly(
    img: NDArray[_S], points: _Array, color: _Scalar, lineType: int = ..., shift: int = ...
) -> NDArray[_S]: ...
def fillPoly(
    img: NDArray[_S], pts: Sequence[_Array], color: _Scalar, lineType: int = ..., shift: int = ...
) -> NDArray[_S]: ...
@overload
def getTextSize(
    text: str, fontFace: int, fontScale: float, thickness: int
) -> tuple[tuple[int, int], int]: ...
@overload
def getTextSize(
    imgsize: _Size, text: str, org: _Point, fface: FontFace, size: int, weight: int = ...
) -> tuple[int, int, int, int]: ...
def line(
    img: NDArray[_S],
    pt1: _Point,
    pt2: _Point,
    color: _Scalar,
    thickness: int = ...,
    lineType: int = ...,
    shift: int = ...,
) -> NDArray[_S]: ...
def polylines(
    img: NDArray[_S],
    pts: Sequence[_Array],
    isClosed: bool,
    color: _Scalar,
    thickness: int = ...,
    lineType: int = ...,
    shift: int = ...,
) -> NDArray[_S]: ...
@overload
def putText(
    img: NDArray[_S],
    text: str,
    org: _Point,
    fontFace: int,
    fontScale: float,
    color: _Scalar,
    thickness: int = ...,
    lineType: int = ...,
) -> NDArray[_S]: ...
@overload
def putText(
    img: _Array, text: str, org: _Point, color: _Scalar, fface: FontFace, size: int, weight: int = ...
) -> tuple[int, int]: ...
