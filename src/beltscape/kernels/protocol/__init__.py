"""What a set of kernels offers: a family a file, each a protocol; `Kernels` is all of them."""

from __future__ import annotations

from typing import Protocol

from beltscape.kernels.protocol.coarse import Searches
from beltscape.kernels.protocol.first_met import Marches
from beltscape.kernels.protocol.hear import Hears
from beltscape.kernels.protocol.local_fit import Fits
from beltscape.kernels.protocol.neighbours import LooksAround
from beltscape.kernels.protocol.normal_equations import Judges
from beltscape.kernels.protocol.occlusion import Occludes
from beltscape.kernels.protocol.perceptron import Weighs
from beltscape.kernels.protocol.propagation import Propagates
from beltscape.kernels.protocol.rivals import Contends
from beltscape.kernels.protocol.top_view import Surveys
from beltscape.kernels.protocol.triangulation import Triangulates
from beltscape.kernels.protocol.warping import Warps
from beltscape.kernels.protocol.windows import Gathers


class Kernels(
    Triangulates,
    Warps,
    Occludes,
    Searches,
    Judges,
    Fits,
    Propagates,
    Weighs,
    Hears,
    Contends,
    LooksAround,
    Surveys,
    Marches,
    Gathers,
    Protocol,
):
    """What every set of kernels offers; stages receive one as a value.

    Every kernel takes ``threads`` (0 takes all cores), on which its result does not depend, and raises
    KernelError where the shapes of its arrays do not fit each other.
    """

    name: str
