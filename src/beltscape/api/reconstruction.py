"""Reconstruction: the images of one instant in, a depth map or a point cloud out."""

from __future__ import annotations

from collections.abc import Mapping

from beltscape.core.arguments import require_depth_of, require_depth_range, require_image
from beltscape.core.checks import require_instance, require_reporter, show_value
from beltscape.core.cloud import PointCloud
from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.core.frames import FrameSet, Image
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import RecordingReporter, Reporter, Silent
from beltscape.pipeline.reconstructing.checked_matcher import CheckedMatcher
from beltscape.stereo.multiview.depth_range import find_depth_range
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.pointcloud import cloud_from_depth
from beltscape.stereo.settings import MultiviewSettings, Preset

Range = tuple[float, float]


class Reconstructor:
    """The matcher of one rig: call it with the images of one instant.

    >>> matcher = bs.Reconstructor(rig, preset="fast")
    >>> depth = matcher({"cam0": image0, "cam1": image1})

    Every frame is checked for cameras that do not fit the rig: one that moved is left out, or the depth's σ grows to
    cover its error, and `warnings` says so.
    """

    def __init__(
        self,
        rig: Rig,
        preset: Preset = "standard",
        depth_range_mm: Range | None = None,
        threads: int = 0,
        *,
        reporter: Reporter | None = None,
    ) -> None:
        """Prepare a rig's matcher.

        Parameters
        ----------
        rig
            The calibrated rig.
        preset
            "fast" or "standard".
        depth_range_mm
            Nearest and farthest surface along the core's optical axis; None: it is found anew in each frame, by
            coarse matching.
        threads
            Number of threads; 0: one per processor core. The result does not depend on it.
        reporter
            Receiver of progress and warnings.

        Raises
        ------
        InputError, SettingsError
            with the argument that does not fit.
        """
        require_instance(rig, Rig, "rig", "bs.read_rig(path)")
        if depth_range_mm is not None:
            require_depth_range(depth_range_mm)
        if isinstance(threads, bool) or not isinstance(threads, int):
            raise InputError(f"threads = {show_value(threads)}: must be a whole number, 0 for one per core")
        require_reporter(reporter)
        self.rig, self.preset, self.depth_range_mm = rig, preset, depth_range_mm
        self._settings = MultiviewSettings.preset(preset).model_copy(update={"threads": threads}).revalidate()
        self._reporter = reporter or Silent()
        self._matchers: dict[Range, CheckedMatcher] = {}
        self._count = 0
        self.warnings: tuple[str, ...] = ()
        """The faults found in the last frame, one line each."""

    def __call__(self, images: Mapping[str, Image] | FrameSet) -> DepthMap:
        """Return the depth map of one instant on the core camera's undistorted grid.

        Parameters
        ----------
        images
            By camera: (H, W) grey or (H, W, 3) RGB, uint8 or uint16, as recorded (distorted); or a `FrameSet`. The
            core's image and one other are needed; cameras without an image are left out.

        Raises
        ------
        InputError
            with the name of an image that does not fit.
        ReconstructionError
            if the images do not suffice, or the cameras contradict the rig grossly.
        """
        frame_set = images if isinstance(images, FrameSet) else FrameSet(f"{self._count:03d}", images)
        self._require_known_cameras(frame_set)
        self._count += 1
        reporter = RecordingReporter(self._reporter)
        near_far = self.depth_range_mm or find_depth_range(
            self.rig, frame_set, reporter, self._settings.threads
        )
        checked = self._make_matcher(near_far).measure(frame_set, reporter)
        for line in checked.faults:
            reporter.warn(line)
        self.warnings = tuple(reporter.warnings)
        return checked.depth

    def _require_known_cameras(self, frame_set: FrameSet) -> None:
        unknown = [name for name in frame_set.images if name not in self.rig.cameras]
        if unknown:
            raise InputError(f"images has {', '.join(unknown)}: the rig has {', '.join(self.rig.cameras)}")

    def _make_matcher(self, near_far: Range) -> CheckedMatcher:
        """Return the matcher of a depth range; the last one is kept."""
        if near_far not in self._matchers:
            rig, settings = self.rig, self._settings
            self._matchers = {
                near_far: CheckedMatcher(
                    rig,
                    rig.auxiliaries,
                    near_far,
                    lambda names: MultiviewReconstructor(rig, near_far, settings, auxiliaries=names),
                )
            }
        return self._matchers[near_far]

    def __repr__(self) -> str:
        found = (
            "found in each frame"
            if self.depth_range_mm is None
            else "{:g} to {:g} mm".format(*self.depth_range_mm)
        )
        return f"Reconstructor({self.preset}, {len(self.rig.cameras)} cameras, depth {found})"


def point_cloud(depth: DepthMap, rig: Rig, image: Image | None = None) -> PointCloud:
    """Return the points of a depth map in the core camera's frame, with normals, colours and σ.

    >>> cloud = bs.point_cloud(depth, rig, image=image0)

    Parameters
    ----------
    depth
        A depth map of this rig.
    rig
        The calibrated rig.
    image
        The core camera's image as recorded, for the colours; None: grey.

    Raises
    ------
    InputError
        with the argument that does not fit.
    """
    require_instance(rig, Rig, "rig", "bs.read_rig(path)")
    require_depth_of(rig.core_camera, depth, "point cloud")
    if image is not None:
        require_image(image, "image")
    return cloud_from_depth(depth, rig.core_camera, image)
