"""The back end of an emulated GPU, beside the native one whose results agree with it."""

from __future__ import annotations

import pytest

from beltscape.kernels.cuda.backend import CudaBackend
from beltscape.kernels.cuda.emulated_device import EmulatedDevice, is_emulation_built
from beltscape.kernels.native import NativeBackend
from tests.kernels.rounding import first_alike

ON_EMULATION = [
    pytest.mark.skipif(not is_emulation_built(), reason="the emulated GPU is not built"),
    pytest.mark.usefixtures("no_failure"),
]


def backend_on(device: EmulatedDevice) -> CudaBackend:
    """Return the back end of a device."""
    return CudaBackend(device, NativeBackend(first_alike("emulated")))
