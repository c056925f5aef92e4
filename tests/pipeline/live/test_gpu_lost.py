"""A GPU that is lost while belts are measured: the processor takes over, an alarm says so, and no record is lost."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from beltscape.kernels import Kernels
from beltscape.kernels.backend import gpu_failures
from beltscape.kernels.cuda.emulated_device import is_emulation_built
from beltscape.pipeline.live.assembly import RunOptions, assemble
from beltscape.service.project import open_project
from tests.kernels.rounding import fusing_levels
from tests.kernels.test_resident import Failing, backend_on
from tests.pipeline.live.feed import Watcher
from tests.reprocessing.conftest import joined_store, recorded_plant, reprocess, run  # noqa: F401
from tests.reprocessing.ledgers import read_records

pytestmark = [
    pytest.mark.skipif(not is_emulation_built(), reason="the emulated GPU is not built"),
    pytest.mark.skipif(not fusing_levels(), reason="no level on this processor fuses, as a GPU does"),
    pytest.mark.filterwarnings("ignore:the GPU is no longer used:RuntimeWarning"),
]
LOST = "CUDA_ERROR_DEVICE_LOST"


@pytest.fixture
def failing(monkeypatch):
    """Kernels of a GPU that is lost in the middle of the first frame, after the stages that run on small images.

    Only the matcher has them: what measures would fail, if it opened a GPU.
    """
    gpu_failures.clear()
    kernels = Kernels(backend_on(Failing(60)))
    monkeypatch.setenv("BELTSCAPE_KERNELS", "cuda")
    monkeypatch.setattr("beltscape.kernels._kernels_on", lambda _: pytest.fail("a GPU is opened"))
    monkeypatch.setattr("beltscape.stereo.multiview.reconstructor.load", lambda: kernels)
    yield kernels
    gpu_failures.clear()


class Watching(Watcher):
    """Keeps the warnings, too."""

    def on_message(self, message: str) -> None:
        pass


def replay(plant: Path, name: str) -> tuple[list[tuple], Watching]:
    path, data, watcher = plant / "project.toml", plant / name, Watching()
    done = assemble(open_project(path), RunOptions(data, paced=False, record=False), watcher)
    done.engine.start()
    assert done.engine.wait(300)
    assert done.engine.stop() == 0
    done.close()
    return read_records(data), watcher


def test_the_live_system_goes_on_with_an_alarm(recorded_plant, tmp_path, request):  # noqa: F811
    plant = shutil.copytree(recorded_plant, tmp_path / "plant")
    expected, without = replay(plant, "without")
    kernels = request.getfixturevalue("failing")
    found, watcher = replay(plant, "lost")
    assert kernels.failure == LOST
    assert found == expected
    assert without.alarms["gpu_lost"] == "clear"
    assert watcher.alarms["gpu_lost"] == "raised"


def test_reprocessing_goes_on_with_a_finding(joined_store, reprocess, tmp_path, failing):  # noqa: F811
    document = reprocess()
    assert failing.failure == LOST
    assert read_records(tmp_path / "store") == read_records(joined_store)
    assert any(f"the processor takes over: {LOST}" in str(each) for each in document["findings"])
