"""``beltscape record`` with simulated cameras: shots and a sequence land on the disk as they were shown."""

from __future__ import annotations

import json

import numpy as np
import pytest

from beltscape.cli.main import main
from beltscape.files.camera_types import CameraType, read_camera_types
from beltscape.files.capture import read_capture
from beltscape.files.encoder_csv import read_encoder
from beltscape.files.images import read_image
from beltscape.sources.fake_genicam.simulated_cameras import SimulatedCameras

NAMES = ("cam0", "cam1")
PICTURES = {
    name: [np.full((48, 64), 40 + 20 * k + own, np.uint8) for k in range(8)] for own, name in enumerate(NAMES)
}


@pytest.mark.cameras
def test_shots_and_a_sequence(fake_network, tmp_path, capsys):
    bench = SimulatedCameras(tmp_path / "bench", PICTURES, 10, [100 * k for k in range(8)], 800)
    project = tmp_path / "project.toml"
    devices = ", ".join(f'{name} = "{address}"' for name, address in bench.devices.items())
    project.write_text(
        f"[cameras]\ndevices = {{ {devices} }}\nmodels = {{ cam1 = 'two of a kind, 8 mm' }}\n"
        f"lens_models = {{ cam1 = 'tilted' }}\nframes_per_s = 10\nexposure_us = 1000\nallowed_skew_ms = 30\n"
        'packet_size = 9000\nencoder = { feature = "TestRegister", mm_per_count = 0.5 }\n'
    )
    with bench:
        words = ["record", str(project), "--json"]
        assert main([*words, "--out", str(tmp_path / "shots"), "--shots", "2", "--every", "0.3"]) == 0
        assert json.loads(capsys.readouterr().out)["frames"] == 2
        assert main([*words, "--out", str(tmp_path / "sequence"), "--sequence", "--shots", "4"]) == 0
        result = json.loads(capsys.readouterr().out)
        assert main([*words, "--out", str(tmp_path / "sequence"), "--sequence", "--shots", "4"]) == 2
    assert result["frames"] == 4
    types = read_camera_types(tmp_path / "shots")
    assert types["cam1"] == CameraType("two of a kind, 8 mm", "tilted")
    assert types["cam0"].model
    assert read_camera_types(tmp_path / "sequence") == types
    shots = read_capture(tmp_path / "shots")
    assert shots.cameras == NAMES
    assert shots.frames == ("000", "001")
    numbers = [
        [(int(read_image(path)[0, 0]) - 40) // 20 for path in files.values()]
        for files in shots.files.values()
    ]
    assert all(0 <= number < 8 for number in numbers[0]), "these are the pictures that are sent"
    assert numbers[0] == numbers[1], "all images of a shot are of one instant"
    positions = [one.belt_position_mm for one in read_encoder(tmp_path / "sequence" / "encoder.csv")]
    assert positions == sorted(positions)
    assert 2 <= len(positions) == 4 - result["without_position"], "a late reading of the encoder is counted"
