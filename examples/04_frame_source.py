"""The simulated plant as a frame source: frame sets one by one in Python.

python examples/04_frame_source.py
"""

from __future__ import annotations

from itertools import islice

from beltscape.simulate.rendering.render import RenderSettings
from beltscape.simulate.scenario import MotionSpec, RigSpec, Scenario
from beltscape.simulate.scene_assembly import SimulatedSource
from beltscape.simulate.solids.heap import HeapSettings

# Small and rough, so that it takes seconds; left out, each is as the paper has it.
PLANT = Scenario(
    kind="belt_moving",
    rig=RigSpec(auxiliaries=2, scale=0.05),
    heap=HeapSettings(rocks=40),
    motion=MotionSpec(speed_mm_s=1500, frames_per_s=10, start_mm=-150),
    render=RenderSettings(passes=1, ambient_samples=1),
)


def main() -> None:
    """Take three frames of a belt that never ends, as one would from a `FolderSource` or from cameras."""
    source = SimulatedSource(PLANT)
    print("cameras", ", ".join(source.cameras))
    for frames in islice(source, 3):
        seconds = (frames.time_ns or 0) / 1e9
        for camera, image in frames.images.items():
            print(
                f"{frames.frame} {seconds:.1f} s {camera} {image.shape} {image.dtype} mean {image.mean():.1f}"
            )
    scene = source.scene  # what is true of it: rig, belt, heap, places
    print("heap's middle, mm along the belt:", [round(scene.heap_position_mm(frame)) for frame in range(3)])


if __name__ == "__main__":
    main()
