"""``beltscape export`` and ``beltscape import`` as commands."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from beltscape.cli.main import main
from beltscape.files.exchange import FORMATS
from beltscape.files.rig_json import read_rig, write_rig
from tests.synthetic.boards import row_of_cameras


@pytest.fixture(autouse=True)
def desk(tmp_path, monkeypatch) -> Path:
    """The working folder with rig.json."""
    monkeypatch.chdir(tmp_path)
    write_rig(Path("rig.json"), row_of_cameras(["left", "mid", "right"]))
    return tmp_path


@pytest.mark.parametrize("kind", FORMATS)
def test_exported_rig_imports_again(capsys, kind):
    assert main(["export", "rig.json", "--format", kind, "--out", "there", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["format"], result["cameras"]) == (kind, ["left", "mid", "right"])
    assert all(Path(file).is_file() for file in result["files"])
    assert main(["import", "there", "--out", "back/rig.json"]) == 0
    assert capsys.readouterr().out.startswith(f"{kind}: 3 cameras about left → back/rig.json\n")
    rig, back = read_rig(Path("rig.json")), read_rig(Path("back/rig.json"))
    for name, camera in rig.cameras.items():
        np.testing.assert_allclose(back.cameras[name].matrix, camera.matrix, rtol=1e-12)
        np.testing.assert_allclose(
            back.cam_from_core[name].translation_mm, rig.cam_from_core[name].translation_mm, atol=1e-9
        )


def test_core_can_be_chosen(capsys):
    main(["export", "rig.json", "--format=colmap", "--out=rig_config.json"])
    assert main(["import", "rig_config.json", "--core=mid", "--out=back.json", "--json"]) == 0
    assert read_rig(Path("back.json")).core == "mid"


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["export", "rig.json", "--format=ros", "--out=rig.json"],
         "beltscape: --out rig.json: is an input (source rig.json); choose another --out"),
        (["export", "gone.json", "--format=ros", "--out=x"], "beltscape: gone.json: no such file"),
        (["export", "rig.json", "--format=matlab", "--out=x"],
         "beltscape export: argument --format: invalid choice: 'matlab'"),
        (["import", "rig.json", "--out=x.json"],
         "beltscape: rig.json: is a rig.json of Beltscape already; use it as it is"),
        (["import", "rig.json", "--out=rig.json"],
         "beltscape: --out rig.json: is an input (source rig.json); choose another --out"),
    ],
)  # fmt: skip
def test_errors_are_one_line(capsys, words, line):
    try:
        code = main(words)
    except SystemExit as stop:
        code = stop.code
    assert code == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert said.startswith(line)


@pytest.mark.parametrize("words", [["--help"], ["export", "--help"], ["import", "--help"]])
def test_help_imports_nothing_heavy(words):
    code = (
        f"from beltscape.cli.main import main\ntry:\n    main({words!r})\nexcept SystemExit:\n    pass\n"
        "import sys\nprint(sorted({'yaml', 'numpy', 'cv2'} & set(sys.modules)), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.splitlines()[-1] == "[]"
