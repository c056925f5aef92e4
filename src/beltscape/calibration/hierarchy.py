"""The paper's calibration hierarchy in one function: monocular, binocular, association, global optimisation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.intrinsics.lens_choice import AUTO, LensChoice, calibrate_with_model
from beltscape.calibration.intrinsics.like_cameras import Restart, restart_weak_cameras
from beltscape.calibration.intrinsics.zhang import MIN_VIEWS, MonocularCalibration, calibrate_camera
from beltscape.calibration.network.association import (
    CameraNetwork,
    associate_cameras,
    chain_cameras,
    find_groups,
    select_core,
)
from beltscape.calibration.network.board_symmetry import unify_numbering
from beltscape.calibration.network.contradicting_frames import ContradictingFrame
from beltscape.calibration.network.global_optimisation import optimise_network
from beltscape.calibration.network.pairs import Pair, calibrate_pairs
from beltscape.calibration.network.synchronisation import find_frame_misfits
from beltscape.calibration.solver.lens import LensPrior
from beltscape.calibration.solver.levenberg_marquardt import single_thread
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.files.frame_names import natural_key
from beltscape.target.board import Board, corner_points_mm

EXCESS_FACTOR, EXCESS_PX = 2.0, 0.25
"""A pair is not synchronous if its RMS exceeds its cameras' own by this factor, and exceeds this many px."""


@dataclass(frozen=True, slots=True, eq=False)
class HierarchyResult:
    """Results of each level of the hierarchy, and the rig."""

    rig: Rig
    detections: BoardDetections
    """Detections of the rig's cameras, numbered from the same end of the board."""
    monocular: Mapping[str, MonocularCalibration]
    network: CameraNetwork
    restarts: tuple[Restart, ...] = ()
    """Cameras whose own views did not determine their lens."""
    fixed_poses: frozenset[str] = frozenset()
    """Cameras whose pose relative to the core is given and fixed."""
    lens_choices: tuple[LensChoice, ...] = ()
    """The lens models of the cameras whose intrinsics were not given."""
    contradicting_frames: tuple[ContradictingFrame, ...] = ()
    """Frames whose views the detections lack: they contradict the pose between cameras that the others give."""


def solve_hierarchy(
    detections: BoardDetections,
    board: Board,
    core: str | None,
    reporter: Reporter,
    *,
    known: Mapping[str, Camera] | None = None,
    priors: Mapping[str, LensPrior] | None = None,
    lens_models: Mapping[str, str] | None = None,
    is_start: bool = False,
) -> HierarchyResult:
    """Calibrate a rig from the board's corners.

    ``lens_models`` are the models of cameras by name; those of the others are chosen from their views.
    The intrinsics of ``known`` cameras (by name) are fixed; those with ``priors`` among them until the bundle is
    adjusted. A camera with too few views, without views shared with
    the rest, or with frames of other instants, is reported and left out. ``is_start`` computes the cameras' poses
    along the best paths only: the network's optimisation and tests are not for a mere start of a joint adjustment.

    Raises
    ------
    CalibrationError
        When the core camera, or all but one camera, cannot be calibrated.
    """
    board_mm = corner_points_mm(board)
    with single_thread():
        monocular, choices = _calibrate_cameras(
            detections, board_mm, core, reporter, known or {}, priors or {}, lens_models or {}
        )
        monocular, restarts = restart_weak_cameras(detections, monocular, board_mm, tuple(known or ()))
        numbering = unify_numbering(detections, monocular, board)
        detections, monocular = numbering.detections, dict(numbering.monocular)
        for line in numbering.ambiguous:
            reporter.warn(line)
        for misfit in find_frame_misfits(monocular, sorted(detections.frames, key=natural_key)):
            if len(monocular) == 2:
                raise CalibrationError(misfit.describe())
            _warn_or_raise(CalibrationError(misfit.describe()), misfit.camera, core, reporter)
            del monocular[misfit.camera]
        pairs = _calibrate_needed_pairs(detections, monocular, board_mm, reporter, core if is_start else None)
    connected = _select_connected(monocular, pairs, core, reporter)
    kept = {name: monocular[name] for name in connected}
    pairs = tuple(pair for pair in pairs if pair.first in kept)
    core = core or select_core(detections.restrict(kept, detections.frames), pairs)
    with single_thread():
        network = chain_cameras(core, pairs) if is_start else optimise_network(associate_cameras(core, pairs))
    order = [core, *(name for name in kept if name != core)]
    rig = Rig(
        core=core,
        cameras={name: kept[name].camera for name in order},
        cam_from_core={name: network.cam_from_core[name] for name in order},
    )
    return HierarchyResult(
        rig, detections.restrict(order, detections.frames), kept, network, restarts,
        lens_choices=tuple(choices[name] for name in order if name in choices),
    )  # fmt: skip


def _calibrate_needed_pairs(
    detections: BoardDetections,
    monocular: Mapping[str, MonocularCalibration],
    board_mm: NDArray[np.float64],
    reporter: Reporter,
    core: str | None,
) -> tuple[Pair, ...]:
    """Calibrate all pairs; with a ``core`` only its own, if they connect all cameras."""
    if core in monocular:
        pairs = calibrate_pairs(detections, monocular, board_mm, reporter, core)
        if len(pairs) == len(monocular) - 1:
            return pairs
    return calibrate_pairs(detections, monocular, board_mm, reporter)


def _calibrate_cameras(
    detections: BoardDetections,
    board_mm: NDArray[np.float64],
    core: str | None,
    reporter: Reporter,
    known: Mapping[str, Camera],
    priors: Mapping[str, LensPrior],
    lens_models: Mapping[str, str],
) -> tuple[dict[str, MonocularCalibration], dict[str, LensChoice]]:
    """Calibrate each camera from its own views; return the calibrations, and the choices of lens models."""
    monocular: dict[str, MonocularCalibration] = {}
    choices: dict[str, LensChoice] = {}
    for done, name in enumerate(detections.cameras, start=1):
        try:
            if name in known:
                monocular[name] = _fit_known(name, detections, board_mm, known, priors)
            else:
                requested = lens_models.get(name, AUTO)
                monocular[name], choices[name] = calibrate_with_model(name, detections, board_mm, requested)
        except CalibrationError as error:
            _warn_or_raise(error, name, core, reporter)
        reporter.step("calibrating cameras", done, len(detections.cameras))
    return monocular, choices


def _fit_known(
    name: str,
    detections: BoardDetections,
    board_mm: NDArray[np.float64],
    known: Mapping[str, Camera],
    priors: Mapping[str, LensPrior],
) -> MonocularCalibration:
    calibration = calibrate_camera(name, detections, board_mm, known=known[name])
    prior = priors.get(name)
    return calibration if prior is None else replace(calibration, fixed=prior.fixed, prior=prior)


def _warn_or_raise(error: CalibrationError, name: str, core: str | None, reporter: Reporter) -> None:
    if name == core:
        raise CalibrationError(f"{error}; it is the core camera: choose another with --core") from error
    reporter.warn(f"{error}; going on without {name}")


def _select_connected(
    monocular: Mapping[str, MonocularCalibration],
    pairs: tuple[Pair, ...],
    core: str | None,
    reporter: Reporter,
) -> tuple[str, ...]:
    """Return the cameras connected with the core, or the largest group; warn of the others."""
    if core is not None and core not in monocular:
        raise CalibrationError(f"core camera {core} has no usable image: choose another with --core")
    if len(monocular) < 2:
        raise CalibrationError(
            f"{'only camera ' + next(iter(monocular)) if monocular else 'no camera'} can be calibrated, "
            f"a rig needs two; take at least {MIN_VIEWS} tilted views with each camera"
        )
    components = find_groups(monocular, pairs)
    best = next(
        (component for component in components if core in component), components[0] if components else ()
    )
    if len(best) < 2:
        lone = core or ", ".join(monocular)
        raise CalibrationError(
            f"{lone}: no view of the board is shared with another camera; "
            "show the board to two cameras in the same frame"
        )
    for component in components:
        for name in component:
            if name not in best:
                reporter.warn(
                    f"camera {name} shares no view of the board with {', '.join(best)}; going on without it"
                )
    return best


def find_unsynchronised_pairs(hierarchy: HierarchyResult) -> list[Pair]:
    """Return pairs that fit far worse than their cameras do alone: unsynchronised, or one of them moved."""
    return [
        pair
        for pair in hierarchy.network.pairs
        if pair.rms_px > EXCESS_PX
        and pair.rms_px
        > EXCESS_FACTOR * max(hierarchy.monocular[pair.first].rms_px, hierarchy.monocular[pair.second].rms_px)
    ]
