"""A certificate's figures against a computation of their own, written anew from the GUM's formulas (JCGM 100:2008).

It begins with the plant's raw records and weighed masses, differentiates by finite differences (GUM 5.1.3), and uses
nothing of the program: pooled scatter (GUM H.5), Welch and Satterthwaite (GUM G.2b), Student's and Fisher's
distributions of scipy, linear regression.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from beltscape.cli.main import main
from tests.pipeline.certifying.plants import BELT_M, DENSITY, RUN_M, SPEED_MM_S, STRIP_MM, SimulatedPlant
from tests.thorough import list_cases

TURNS, OWN_MM2 = 3, 30.0
"""Whole turns of the zero test, and σ of one strip's cross-section that no other strip shares."""
SCALE_SHARE, SCALE_KG, STEP_KG, SCALE_FREEDOM = 0.0005, 4.0, 5.0, 50
SAMPLE, SAMPLE_SIGMA, SAMPLE_FREEDOM = 1600.0, 8.0, 9
MOISTURE, MOISTURE_SIGMA, MOISTURE_FREEDOM = 0.06, 0.002, 4
SPILT = 0.0007
HEAD = f"""name = "by hand"
belt_length_m = {BELT_M}
[reference]
sigma_percent = {100 * SCALE_SHARE}
sigma_kg = {SCALE_KG}
resolution_kg = {STEP_KG}
degrees_of_freedom = {SCALE_FREEDOM}
[density]
kg_m3 = {SAMPLE}
sigma_kg_m3 = {SAMPLE_SIGMA}
degrees_of_freedom = {SAMPLE_FREEDOM}
[moisture]
percent = {100 * MOISTURE}
sigma_percent = {100 * MOISTURE_SIGMA}
degrees_of_freedom = {MOISTURE_FREEDOM}
[[effects]]
name = "spilt"
sigma_percent = {100 * SPILT}
"""
STRAIGHT = {"third": (40_000.0, 1.0), "half": (60_000.0, 1.0), "full": (120_000.0, 1.0)}
BENT = {**STRAIGHT, "full": (120_000.0, 1.02)}
"""Load → true cross-section, mm², and how much more of it is measured."""


@dataclass
class Raw:
    """What a person would write down beside the belt."""

    zero_mm3: np.ndarray
    """Volume of every strip of the zero test."""
    loads: list[str] = field(default_factory=list)
    masses_kg: list[float] = field(default_factory=list)
    volumes_m3: list[float] = field(default_factory=list)
    lengths_m: list[float] = field(default_factory=list)


def make_plant(
    folder: Path, loads: Mapping[str, tuple[float, float]], scatter: float
) -> tuple[SimulatedPlant, Raw]:
    plant = SimulatedPlant(folder, seed=7)
    plant.add_zero(TURNS)
    raw = Raw(np.array([one.volume_mm3 for one in plant.records]))
    for _ in range(3):
        for load, (area, gain) in loads.items():
            chance = math.exp(float(plant.rng.normal(0, scatter)))
            count = round(RUN_M * 1000 / STRIP_MM)
            first, last = plant.pass_belt([0.0] * 5 + [area * gain * chance] * count + [0.0] * 5)
            mass = STEP_KG * round(area * 1e-6 * RUN_M * DENSITY / STEP_KG)
            plant.lines.append(f'[[runs]]\nload = "{load}"\nmass_kg = {mass}\nrecords = [{first}, {last}]\n')
            strips = plant.records[first - 1 : last]
            raw.loads.append(load)
            raw.masses_kg.append(mass)
            raw.volumes_m3.append(1e-9 * math.fsum(one.volume_mm3 for one in strips))
            raw.lengths_m.append(len(strips) * STRIP_MM / 1000)
    plant.write(HEAD)
    return plant, raw


@dataclass(frozen=True)
class Stated:
    """What the independent computation states of a result."""

    value: float
    sigma: float
    sigma_a: float
    sigma_b: float
    freedom: float
    expanded: float


class ByHand:
    """The evaluation of the raw figures."""

    def __init__(self, raw: Raw) -> None:
        self.raw, self.names = raw, list(dict.fromkeys(raw.loads))
        self.mass, self.length = np.array(raw.masses_kg), np.array(raw.lengths_m)
        self.volume = np.array(raw.volumes_m3)
        turns = raw.zero_mm3.reshape(TURNS, -1).sum(axis=1) / (BELT_M * 1000)
        by_turns = turns.std(ddof=1) / math.sqrt(TURNS)
        by_strips = OWN_MM2 / math.sqrt(len(raw.zero_mm3))
        self.zero_mm2 = float(turns.mean())
        self.zero_sigma, self.zero_freedom = max((by_turns, TURNS - 1.0), (by_strips, math.inf))
        self.ratios = np.log(self.mass / (self.volume - 1e-6 * self.zero_mm2 * self.length))
        own = [self.ratios[self.is_of(name)] for name in self.names]
        self.free = len(self.ratios) - len(own)
        self.run_sigma = math.sqrt(sum(float(((one - one.mean()) ** 2).sum()) for one in own) / self.free)
        self.f, self.probability = stats.f_oneway(*own)
        means = [one.mean() for one in own]
        self.bend = (max(means) - min(means)) / math.sqrt(12) if self.probability < 0.05 else 0.0

    def is_of(self, name: str) -> np.ndarray:
        return np.array([one == name for one in self.raw.loads])

    def list_inputs(self) -> dict[str, tuple[float, float, float, str]]:
        """Return estimate, standard uncertainty, degrees of freedom and type of every input."""
        count = len(self.ratios)
        corrected = self.volume - 1e-6 * self.zero_mm2 * self.length
        own_m3 = OWN_MM2 * STRIP_MM * 1e-9 * np.sqrt(self.length * 1000 / STRIP_MM)
        # a mass is the difference of two readings, each rounded to a step
        steps = math.sqrt(
            float(np.sum(2 * (STEP_KG / math.sqrt(12) / self.mass) ** 2 + (own_m3 / corrected) ** 2))
        )
        scatter = (self.run_sigma / math.sqrt(count), float(self.free), "A")
        return {
            "scatter": (0.0, *max(scatter, (steps / count, math.inf, "B"))),
            "share": (0.0, SCALE_SHARE, SCALE_FREEDOM, "B"),
            "constant": (0.0, SCALE_KG, SCALE_FREEDOM, "B"),
            "zero": (
                self.zero_mm2,
                self.zero_sigma,
                self.zero_freedom,
                "A" if self.zero_freedom < math.inf else "B",
            ),
            "bend": (0.0, self.bend, math.inf, "B"),
            "spilt": (0.0, SPILT, math.inf, "B"),
            "density": (SAMPLE, SAMPLE_SIGMA, SAMPLE_FREEDOM, "B"),
            "moisture": (MOISTURE, MOISTURE_SIGMA, MOISTURE_FREEDOM, "B"),
        }

    def compute(self, given: Mapping[str, float]) -> dict[str, float]:
        """Return all results from the inputs."""
        masses = self.mass * (1 + given["share"]) + given["constant"]
        volumes = self.volume - 1e-6 * given["zero"] * self.length
        common = given["scatter"] + given["bend"] + given["spilt"]
        factor = math.exp(float(np.mean(np.log(masses / volumes))) + common)
        span = factor / given["density"]
        recorded = self.volume * DENSITY  # the plant's own density, without the test's zero
        return {
            "mass_factor": factor,
            "span_factor": span,
            "bulk_density": given["density"],
            "dry_density": given["density"] * (1 - given["moisture"]),
            "moisture": 100 * given["moisture"],
            "volume_error": 100 * (1 / span - 1),
            "mass_error": 100 * math.expm1(float(np.mean(np.log(recorded / masses))) - common),
        }

    def state(self, key: str, confidence: float = 0.95) -> Stated:
        """Propagate the inputs' uncertainties (GUM 5.1.2) by finite differences."""
        inputs = self.list_inputs()
        at = {name: one[0] for name, one in inputs.items()}
        parts: dict[str, float] = {}
        for name, (estimate, sigma, _, _) in inputs.items():
            low, high = ({**at, name: estimate + side * 1e-3 * sigma} for side in (-1, 1))
            parts[name] = (self.compute(high)[key] - self.compute(low)[key]) / 2e-3
        by_type = {
            kind: math.sqrt(sum(parts[n] ** 2 for n in inputs if inputs[n][3] == kind)) for kind in "AB"
        }
        sigma = math.sqrt(sum(one**2 for one in parts.values()))
        rest = sum(parts[name] ** 4 / inputs[name][2] for name in inputs)
        freedom = sigma**4 / rest if rest else math.inf
        factor = stats.t.ppf((1 + confidence) / 2, freedom)
        return Stated(self.compute(at)[key], sigma, by_type["A"], by_type["B"], freedom, factor * sigma)


CASES = {"scattering": (STRAIGHT, 0.003), "bent": (BENT, 0.002), "quiet": (STRAIGHT, 0.0)}
"""Loads, and σ of a run."""


@pytest.fixture(scope="module", params=list_cases(CASES, {"bent"}))
def certified(request, tmp_path_factory) -> tuple[str, dict[str, Any], ByHand]:
    """The signed statement of a plant, and the independent computation."""
    plant, raw = make_plant(tmp_path_factory.mktemp(request.param) / "plant", *CASES[request.param])
    words = ["certify", "material", str(plant.folder / "material_test.toml"), "--project", str(plant.path)]
    assert main([*words, "--issue", "--by", "eva", "--out", str(plant.folder / "test")]) == 0
    (path,) = (plant.folder / "data/certificates").glob("*.json")
    signed = json.loads(path.read_text())
    return request.param, signed["document"], ByHand(raw)


def test_every_result_its_types_and_its_expanded_uncertainty(certified) -> None:
    _, document, hand = certified
    found = {one["key"]: one for one in (*document["results"], *document["errors"])}
    assert set(found) == set(hand.compute({name: one[0] for name, one in hand.list_inputs().items()}))
    for key, one in found.items():
        stated = hand.state(key)
        assert one["value"] == pytest.approx(stated.value, rel=1e-9), key
        assert (one["sigma"], one["expanded"]) == pytest.approx((stated.sigma, stated.expanded), rel=2e-5), (
            key
        )
        assert (one["sigma_a"], one["sigma_b"]) == pytest.approx(
            (stated.sigma_a, stated.sigma_b), rel=2e-5
        ), key
        freedom = math.inf if one["degrees_of_freedom"] is None else one["degrees_of_freedom"]
        assert freedom == pytest.approx(stated.freedom, rel=1e-4), key


def test_the_cases_are_what_they_are_meant_for(certified) -> None:
    name, _, hand = certified
    assert (hand.bend > 0) == (name == "bent")
    assert hand.list_inputs()["scatter"][3] == ("B" if name == "quiet" else "A")


def test_linearity_over_the_load(certified) -> None:
    name, document, hand = certified
    own = document["repeatability"]["mass"]
    assert (own["linearity"]["f"], own["linearity"]["probability"]) == pytest.approx(
        (hand.f, hand.probability)
    )
    assert own["linearity"]["is_significant"] == (hand.probability < 0.05) == (name == "bent")
    assert own["linearity"]["degrees_of_freedom"] == [len(hand.names) - 1, hand.free]
    flow = hand.volume / (hand.length * 1000 / SPEED_MM_S) * 3600
    line = stats.linregress(flow, hand.ratios)
    spread = float(((flow - flow.mean()) ** 2).sum())
    assert own["slope_percent_per_100_m3_h"] == pytest.approx(-1e4 * line.slope, rel=1e-7)
    assert own["slope_sigma_percent_per_100_m3_h"] == pytest.approx(1e4 * hand.run_sigma / math.sqrt(spread))
    fitted = line.intercept + line.slope * flow
    away = sum(
        float((hand.ratios[at] - fitted[at]).mean() ** 2 * at.sum()) for at in map(hand.is_of, hand.names)
    )
    f = away / (len(hand.names) - 2) / hand.run_sigma**2
    assert own["lack_of_fit"]["f"] == pytest.approx(f, rel=1e-6)
    assert own["lack_of_fit"]["probability"] == pytest.approx(
        stats.f.sf(f, len(hand.names) - 2, hand.free), rel=1e-6
    )


def test_every_load_s_deviation_from_all_of_them(certified) -> None:
    _, document, hand = certified
    at = {name: one[0] for name, one in hand.list_inputs().items()}

    def deviate(name: str) -> Callable[[float, float], float]:
        def compute(constant: float, zero_mm2: float) -> float:
            ratios = np.log((hand.volume - 1e-6 * zero_mm2 * hand.length) / (hand.mass + constant))
            return 100 * math.expm1(ratios[hand.is_of(name)].mean() - ratios.mean())

        return compute

    for one in document["loads"]:
        compute, count = deviate(one["load"]), int(hand.is_of(one["load"]).sum())
        assert one["deviation_percent"] == pytest.approx(compute(0.0, at["zero"]), abs=1e-9)
        by_constant = (compute(SCALE_KG, at["zero"]) - compute(-SCALE_KG, at["zero"])) / 2
        sides = (compute(0.0, at["zero"] + side * hand.zero_sigma) for side in (1, -1))
        by_zero = (next(sides) - next(sides)) / 2
        scatter = 100 * hand.run_sigma * math.sqrt(1 / count - 1 / len(hand.ratios))
        expected = math.sqrt(scatter**2 + by_constant**2 + by_zero**2)
        assert one["deviation_sigma_percent"] == pytest.approx(expected, rel=0.03)  # first order, at the mean
