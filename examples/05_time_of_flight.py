"""A time-of-flight camera over a loaded belt: its depth and each of its errors against the truth.

python examples/05_time_of_flight.py
"""

from __future__ import annotations

import numpy as np

from beltscape.core.geometry.pose import Pose
from beltscape.simulate.rig_and_projector import DOWN
from beltscape.simulate.solids.belt import BeltSettings, make_belt_solids
from beltscape.simulate.solids.heap import HeapSettings, make_heap
from beltscape.simulate.time_of_flight import simulate_tof_frame, trace_tof_truth
from beltscape.simulate.time_of_flight_signal import TofSettings
from beltscape.simulate.world import World

SAMPLES = 3  # rays per pixel in each direction: pixels on a step mix what they see
IDEAL = {"harmonics": (0.0, 0.0), "intensity_error_mm": 0.0, "scatter": 0.0, "multipath": False}
CAMERAS = {
    "noise and flying pixels": TofSettings(size_px=(320, 240), **IDEAL),
    "+ harmonics (wiggling)": TofSettings(size_px=(320, 240), **{**IDEAL, "harmonics": (0.006, 0.002)}),
    "+ error of dark pixels": TofSettings(size_px=(320, 240), **{**IDEAL, "intensity_error_mm": 4.0}),
    "+ light over second surfaces": TofSettings(size_px=(320, 240), **{**IDEAL, "multipath": True}),
    "+ light scattered in the lens": TofSettings(size_px=(320, 240), **{**IDEAL, "scatter": 0.003}),
    "all": TofSettings(size_px=(320, 240)),
    "all, 25 and 40 MHz": TofSettings(size_px=(320, 240), modulation_hz=(25e6, 40e6)),
}


def main() -> None:
    """One frame per camera, against the truth."""
    belt = BeltSettings()
    heap = make_heap(HeapSettings(rocks=120), belt)
    world = World((*make_belt_solids(belt), *heap.solids), None)
    tof_from_world = Pose(DOWN, DOWN @ np.array([0.0, 0.0, -744.0]))
    truth = trace_tof_truth(world, tof_from_world, CAMERAS["all"], SAMPLES)
    middle = truth.depth_mm[SAMPLES // 2 :: SAMPLES, SAMPLES // 2 :: SAMPLES]
    print(f"{'':30}  bias mm  spread mm  predicted σ mm  measured")
    for name, camera in CAMERAS.items():
        frame = simulate_tof_frame(truth, camera, seed=1)
        error = frame.depth_mm - middle
        low, median, high = np.nanquantile(error, [0.1587, 0.5, 0.8413])
        measured = float(np.isfinite(error).mean())
        sigma = float(np.nanmedian(frame.sigma_mm))
        print(f"{name:30} {median:8.2f} {(high - low) / 2:10.2f} {sigma:15.2f} {100 * measured:8.1f} %")


if __name__ == "__main__":
    main()
