"""The quantities that people type: what each can be and usually is, and why its limits tell units apart."""

from __future__ import annotations

from beltscape.core.plausibility import Quantity

LOAD_HEIGHT = Quantity("the height of a load", "mm", (2, 5000), (20, 1500))
"""Loads are some hundred mm high; in metres they are below 1.5, so that 2 separates the two."""
BELT_WIDTH = Quantity("a width of belt", "mm", (20, 20_000), (150, 4000))
"""Belts are 300 to 3200 mm wide (ISO 251), those of laboratories 100 and more; in metres all are below 20."""
TOP_WIDTH = Quantity("the width of a load's top", "mm", (3, 20_000), (20, 4000))
"""A load may end in a ridge or be as wide as the belt; in metres all widths are below 3."""
RIG_HEIGHT = Quantity("the height of a camera over the belt", "mm", (30, 20_000), (150, 8000))
"""Rigs hang 0.5 to 3 m high; in metres all are below 30."""
BASELINE = Quantity("the distance of two cameras", "mm", (2, 20_000), (20, 5000))
"""Planned rigs have 100 to 1000 mm; the limit of 2 is that of a rig's baselines."""
DISTANCE = Quantity("a distance from the camera", "mm", (10, 100_000), (100, 30_000))
"""Surfaces nearer than 10 mm are within the lens; in metres all distances of rigs are below it or near it."""
BOX_SIDE = Quantity("the side of a box on the belt", "mm", (5, 100_000), (5, 100_000))
"""Narrower boxes hold a few points only; in metres boxes on belts are below 5."""
SQUARE = Quantity("the edge of a board's square", "mm", (0.6, 1000), (3, 300))
"""Boards of rigs have squares of 5 to 100 mm; in metres those are below 0.3, in inches below 12."""
MARKER = Quantity("the edge of a board's marker", "mm", (0.4, 1000), (2, 300))
"""Markers take two thirds of their squares; in metres they are below 0.3."""
SOLID = Quantity("the size of a module's solid", "mm", (2, 2000), (5, 1000))
"""Solids that a rig measures are 20 to 200 mm large; in metres they are below 2."""
MODULE_SIDE = Quantity("the side of a module's base", "mm", (5, 5000), (60, 3000))
"""The paper's base is 285 mm long; in metres bases are below 5, in centimetres mostly below 60."""
PLATE = Quantity("the thickness of a plate", "mm", (0.2, 500), (0.5, 200))
"""Plates in metres are below 0.2."""
LUMP = Quantity("the size of a lump", "mm", (1, 3000), (5, 1500))
"""Lumps that block a chute are some 50 to 1000 mm large; in metres they are below 1.5, mostly below 1."""
SIEVE = Quantity("the aperture of a sieve", "mm", (0.3, 3000), (0.3, 3000))
"""Cameras over a belt show no grains below 0.3 mm; in metres apertures are below it."""
CELL = Quantity("the edge of a cell", "mm", (0.02, 100), (0.1, 60))
"""Cells are one or some pixels, 0.2 to 3 mm; in metres they are below 0.02."""
PROFILE = Quantity("the distance of two cross-sections", "mm", (0.5, 10_000), (5, 2000))
"""Some cross-sections to a view of 300 to 1000 mm."""
STRETCH = Quantity("a length of belt", "mm", (3, 100_000), (20, 20_000))
"""Lengths that the flow is cut into; in metres they are below 3."""
DENSITY = Quantity("a bulk density", "kg_m3", (5, 30_000), (40, 9000))
"""Foam beads have 15, iron ore 3000; in t/m³ all are below 5. Tungsten has 19,300."""
DENSITY_SIGMA = Quantity("the σ of a bulk density", "kg_m3", (0, 10_000), (0.3, 2000), is_zero_possible=True)
"""A percent of 100 to 3000 kg/m³ and more; in t/m³ below 0.3."""
BELT_SPEED = Quantity("the speed of a belt", "m_s", (0.005, 20), (0.05, 12), is_zero_possible=True)
"""Belts run at 0.1 to 8 m/s, the fastest at 12."""
BELT_SPEED_MM = Quantity("the speed of a belt", "mm_s", (10, 20_000), (50, 12_000), is_zero_possible=True)
"""Belts run at 0.1 to 8 m/s, the fastest at 12; in m/s all are below 20 and mostly below 10."""
FASTEST_SPEED = Quantity("the fastest speed of a belt", "mm_s", (50, 50_000), (200, 50_000))
"""Twice as fast as any belt, to let an encoder slip; in m/s below 50."""
STOPPED_SPEED = Quantity("the speed of a stopped belt", "mm_s", (0.1, 5000), (1, 500))
"""A stopped belt creeps by some mm/s; in m/s that is below 0.1."""
EXPOSURE = Quantity("an exposure time", "us", (1, 1e7), (15, 200_000))
"""Flashes of projectors last 20 µs and more; in milliseconds exposures are 0.05 to 20."""
FRAME_RATE = Quantity("a rate of frames", "per_s", (0.001, 1000), (0.05, 500))
"""Cameras over belts give 1 to 200 frames a second."""
CROSS_SECTION = Quantity("the cross-section of a load", "mm2", (20, 1e8), (500, 1e7))
"""Loads have 1,000 to 1,000,000 mm²; in m² they are below 5, in cm² 10 to 10,000."""
CARRY_BACK = Quantity("the cross-section of carry-back", "mm2", (2, 1e6), (20, 1e5))
"""Some hundred mm² are worth a report; in m² that is below 0.1, in cm² below 1000."""
OFFSET = Quantity("the misalignment of a belt", "mm", (1, 3000), (3, 600))
"""Belts run off by some ten mm; in metres that is below 1."""
ZERO_SHIFT = Quantity("a shift of the belt's zero", "mm", (0.005, 1000), (0.02, 200))
"""Belts wear by tenths of a mm and rise by some mm; in metres that is below 0.005."""
BELT_LENGTH = Quantity("the length of an endless belt", "m", (1, 50_000), (3, 20_000))
"""Belts are 5 m to 20 km long; in mm they are above 3000."""
MOISTURE = Quantity("a share of water", "percent", (0, 100), (0.2, 80), is_zero_possible=True)
"""Bulk materials hold 1 to 50 %; as a share of 1 below 0.5."""
SCALE_SIGMA = Quantity("the σ of a belt scale", "percent", (0.01, 50), (0.05, 20))
"""Scales of classes 0.2 to 2 (OIML R 50) keep 0.1 to 2 %; as a share of 1 below 0.05."""
DISK_SPACE = Quantity("a size on the disk", "gib", (0, 1e6), (0.0001, 50_000))
"""Disks have up to some ten TiB; in MiB or bytes sizes are above."""
ENCODER_STEP = Quantity("the travel of a count", "mm", (1e-6, 1000), (5e-4, 400))
"""Encoders on pulleys give 0.001 to 10 mm per count, a switch once a turn some 100; in metres below 5e-4."""
