"""The types of the names that `beltscape` loads on first use."""

from beltscape.api.calibration import calibrate
from beltscape.api.files import (
    demo_folder,
    read_belt,
    read_capture,
    read_depth,
    read_rig,
    write_belt,
    write_cloud,
    write_depth,
    write_ply,
    write_rig,
)
from beltscape.api.flow import FlowMeter
from beltscape.api.measuring import (
    learn_belt,
    measure_features,
    measure_lumps,
    measure_volume,
)
from beltscape.api.reconstruction import Reconstructor, point_cloud
from beltscape.core.cloud import PointCloud
from beltscape.core.depth import DepthMap
from beltscape.core.empty_belt import Belt
from beltscape.core.errors import BeltscapeError
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig, scale_rig
from beltscape.core.height_map import BeltProfile, HeightMap
from beltscape.core.ledger import FlowRecord

__version__: str
__all__ = [
    "Belt",
    "BeltProfile",
    "BeltscapeError",
    "Camera",
    "DepthMap",
    "FlowMeter",
    "FlowRecord",
    "FrameSet",
    "HeightMap",
    "PointCloud",
    "Pose",
    "Reconstructor",
    "Rig",
    "calibrate",
    "demo_folder",
    "learn_belt",
    "measure_features",
    "measure_lumps",
    "measure_volume",
    "point_cloud",
    "read_belt",
    "read_capture",
    "read_depth",
    "read_rig",
    "scale_rig",
    "write_belt",
    "write_cloud",
    "write_depth",
    "write_ply",
    "write_rig",
]
