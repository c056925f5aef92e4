"""Digests of the empty belt's files: a flipped byte anywhere is refused."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.files.belt_json import read_belt, write_belt
from beltscape.files.reconstruction import require_intact, write_reconstruction
from tests.files.test_belt_json import CAMERA, belt


def test_flipped_bytes_of_belt_json_are_refused(tmp_path):
    path = tmp_path / "belt.json"
    write_belt(path, belt(), CAMERA)
    sound = path.read_bytes()
    before = [array for one in [read_belt(path)[0]] for array in (one.x_mm, one.z_mm, one.z_sigma_mm)]
    refused = 0
    for place in np.random.default_rng(1).integers(0, len(sound), 300):
        damaged = bytearray(sound)
        damaged[place] ^= 1 << int(place) % 7
        path.write_bytes(bytes(damaged))
        try:
            back, _ = read_belt(path)
        except InputError:
            refused += 1
        else:  # only a flip that leaves all values as they are, such as a space that became another
            for one, two in zip(before, (back.x_mm, back.z_mm, back.z_sigma_mm), strict=True):
                np.testing.assert_array_equal(one, two)
    assert refused > 270


def test_belt_json_without_digest_is_accepted(tmp_path):
    path = tmp_path / "belt.json"
    write_belt(path, belt(), CAMERA)
    text = path.read_text()
    path.write_text(text[: text.index(',\n "sha256"')] + "\n}\n")
    assert read_belt(path)[0].frames == 4


@pytest.mark.parametrize("name", ["rig.json", "000/depth.tiff", "000/views.png", "reconstruction.json"])
def test_flipped_byte_of_a_reconstruction_is_refused(tmp_path, name):
    (tmp_path / "000").mkdir()
    for part in ("rig.json", "000/depth.tiff", "000/sigma.tiff", "000/confidence.tiff", "000/views.png"):
        (tmp_path / part).write_bytes(b"12345678")
    write_reconstruction(tmp_path, {"method": "multiview"}, [{"frame": "000", "systematic_mm": 0.5}])
    require_intact(tmp_path, "000")
    path = tmp_path / name
    path.write_bytes(path.read_bytes().replace(b"5", b"7", 1))
    with pytest.raises(InputError, match=rf"{path.name}: its content contradicts its sha256"):
        require_intact(tmp_path, "000")
