"""CNES Pandora as the matcher of rectified pairs: census or a learned cost, semi-global optimisation, and intervals.

Its pairs are rectified, brought to the core's grid and averaged as those of the pairwise method, so that only the
matcher differs. Pandora (Cournet et al. 2020, doi:10.5194/isprs-archives-XLIII-B2-2020-347-2020) takes the learned
cost from MC-CNN (Žbontar & LeCun 2016, arXiv:1510.05970) with the weights it ships, which were fitted to Middlebury
images, and the optimisation from libSGM.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

import cv2
import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.rig import Rig
from beltscape.stereo.pairwise.reconstructor import estimate_sigma, fuse_depths
from beltscape.stereo.pairwise.rectification import take_square_root
from beltscape.stereo.pairwise.sgbm import PairMatcher, make_pair_matcher, sample_values
from beltscape.stereo.settings import PairwiseSettings
from captures import Scene

COSTS: dict[str, dict[str, Any]] = {
    "census": {"matching_cost_method": "census", "window_size": 5},
    "MC-CNN": {"matching_cost_method": "mc_cnn"},
}
"""Pandora's matching costs."""
COVERAGE = 0.9
"""Possibility of Pandora's intervals."""


@dataclass(frozen=True)
class PairResult:
    """Depth of a pair on the core's grid (H, W), mm, and the ends of its interval; NaN where not measured."""

    depth_mm: np.ndarray
    nearest_mm: np.ndarray
    farthest_mm: np.ndarray


class PandoraMatcher:
    """Pandora for all pairs of a rig with the core."""

    def __init__(self, rig: Rig, near_far: tuple[float, float], cost: str) -> None:
        pandora: Any = import_module("pandora")
        pandora.import_plugin()
        self._rig, self._cost, self._settings = rig, cost, PairwiseSettings()
        self._pairs = {
            name: make_pair_matcher(rig, name, near_far, self._settings) for name in rig.auxiliaries
        }

    def match(self, scene: Scene) -> tuple[DepthMap, list[PairResult]]:
        """Return the mean depth over the pairs that agree, and the pairs' own."""
        images = {name: take_square_root(image) for name, image in scene.frame.images.items()}
        found = [
            self._match_pair(pair, images[self._rig.core], images[name]) for name, pair in self._pairs.items()
        ]
        scale = float(np.mean([p.pair.focal_px * p.pair.baseline_mm for p in self._pairs.values()]))
        agreement = self._settings.agreement_px
        fused = fuse_depths(
            np.stack([one.depth_mm for one in found]).astype(np.float32),
            None if agreement is None else agreement / scale,
        )
        confidence = (fused.views / len(found)).astype(np.float32)
        return DepthMap(fused.depth_mm, estimate_sigma(fused, scale), fused.views, confidence), found

    def _match_pair(self, matcher: PairMatcher, core_root: np.ndarray, aux_root: np.ndarray) -> PairResult:
        pair = matcher.pair
        left, right = (
            cv2.remap(root, source, None, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
            for root, source in ((core_root, pair.core_map), (aux_root, pair.aux_map))
        )
        maps = _run_pandora(left, right, pair.disparities, COSTS[self._cost])
        columns = np.arange(left.shape[1])
        beside = np.rint(columns - np.nan_to_num(maps[0])).astype(np.intp)
        outside = ~np.take_along_axis(matcher.aux_mask, np.clip(beside, 0, len(columns) - 1), axis=1)
        depth = []
        for disparity in maps:
            disparity[outside] = np.nan
            sampled = sample_values(disparity, matcher.sample_map)
            depth.append(np.asarray(pair.depth_from_disparity(sampled) / matcher.depth_ratio))
        return PairResult(depth[0], depth[2], depth[1])


def _run_pandora(
    left: np.ndarray, right: np.ndarray, disparities: int, cost: dict[str, Any]
) -> list[np.ndarray]:
    """Return disparity and both ends of its interval (H, W), px, positive as OpenCV's; NaN where invalid."""
    pandora, criteria, state_machine = (
        import_module(name) for name in ("pandora", "pandora.criteria", "pandora.state_machine")
    )
    schema = import_module("pandora.matching_cost.matching_cost").AbstractMatchingCost.schema
    known = dict(schema)
    machine: Any = state_machine.PandoraMachine()
    images = _make_dataset(left, -disparities, 0), _make_dataset(right, 0, disparities)
    # the check reads the names of bands, of which one band has none
    described = (image.assign_coords(band_im=[None]) for image in images)
    machine.check_conf({"pipeline": _make_pipeline(cost)}, *described)
    found, _ = pandora.run(machine, *images, {"pipeline": machine.pipeline_cfg["pipeline"]})
    schema.clear(), schema.update(known)  # MC-CNN adds its own keys to the schema of all costs
    invalid = (found["validity_mask"].data & int(criteria.Criteria.PANDORA_MSK_PIXEL_INVALID)) != 0
    measures = found["confidence_measure"]
    ends = {str(name): k for k, name in enumerate(measures.coords["indicator"].data)}
    upper, lower = (next(k for name, k in ends.items() if end in name) for end in ("_sup", "_inf"))
    maps = [-found["disparity_map"].data, *(-measures.data[..., k] for k in (upper, lower))]
    return [np.where(invalid, np.nan, part).astype(np.float32) for part in maps]


def _make_pipeline(cost: dict[str, Any]) -> dict[str, dict[str, Any]]:
    learned = cost["matching_cost_method"] == "mc_cnn"
    penalty = {"penalty_method": "mc_cnn_fast_penalty" if learned else "sgm_penalty"}
    return {
        "matching_cost": {**cost, "subpix": 1},
        "optimization": {"optimization_method": "sgm", "penalty": penalty},
        "cost_volume_confidence": {
            "confidence_method": "interval_bounds",
            "possibility_threshold": COVERAGE,
        },
        "disparity": {"disparity_method": "wta", "invalid_disparity": "NaN"},
        "refinement": {"refinement_method": "vfit"},
        "filter": {"filter_method": "median", "filter_size": 3},
        "validation": {"validation_method": "cross_checking_accurate"},
    }


def _make_dataset(image: np.ndarray, lowest: int, highest: int) -> Any:
    """Return an image (H, W) with its range of disparities as Pandora takes it."""
    xarray, img_tools = (import_module(name) for name in ("xarray", "pandora.img_tools"))
    rows, columns = image.shape
    dataset = xarray.Dataset(
        {"im": (["row", "col"], image.astype(np.float32))},
        coords={"row": np.arange(rows), "col": np.arange(columns)},
        attrs={"crs": None, "transform": None, "valid_pixels": 0, "no_data_mask": 1, "no_data_img": -1},
    )
    return img_tools.add_disparity(dataset, [lowest, highest], None)
