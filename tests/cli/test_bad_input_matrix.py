"""Bad input to all commands: one line that names the fault and the fix, exit code 2, no output left."""

from __future__ import annotations

import json
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

from beltscape.cli.main import main
from beltscape.core.cloud import PointCloud
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.files.reconstruction import write_frame
from beltscape.files.rig_json import write_rig
from tests.synthetic.packings import camera, make_ellipsoids, render_depth_map

FLOW = "measure flow cap --rig rig.json --empty two"
BOARD = "target board --squares 12 9 --square 30 --marker 22 --dictionary DICT_5X5_100"
CASES = f"""
calibrate nowhere --board board.toml --out o => nowhere: no such folder; a capture is
calibrate rig.json --board board.toml --out o => rig.json: is a file; a capture is a folder
calibrate dir --board board.toml --out o => dir: no camera folder with images in it
calibrate cap --board nope.toml --out o => nope.toml: no such file
calibrate cap --board dir --out o => dir: cannot be read (Is a directory)
calibrate cap --board bin.json --out o => bin.json: not UTF-8 text
calibrate cap --board module.toml --out o => module.toml: kind is missing
calibrate cap --board board.toml --out cap => --out cap: is an input (capture cap)
calibrate cap --board board.toml --out cap/rig => --out cap/rig: lies in the capture cap
calibrate cap --board board.toml --out . => . (the working folder): holds
calibrate cap --board board.toml --out text.txt => text.txt is a file, not a folder
calibrate cap --board board.toml --out text.txt/x => text.txt is a file, not a folder
calibrate cap --board board.toml --out broken => broken is a broken link
calibrate cap --board board.toml --out /proc/x => /proc/x: cannot be written
calibrate cap --board board.toml --out two => two: holds 000, 001, rig.json, written without a manifest
calibrate cap --board board.toml --out "" => argument --out: is empty; give a name
calibrate cap --board board.toml --intrinsics text.txt --out o => text.txt: is none of opencv, kalibr
calibrate cap --board board.toml --intrinsics dir --out o => dir: holds no .yaml file
calibrate cap --board board.toml --core => argument --core: expected one argument
check cap --rig nope.json --board board.toml => nope.json: no such file
check cap --rig dir --board board.toml => dir: cannot be read (Is a directory)
check cap --rig empty.json --board board.toml => empty.json: not JSON (line 1, column 1
check cap --rig list.json --board board.toml => list.json: format is None
check cap --rig bin.json --board board.toml => bin.json: not UTF-8 text
check cap --rig words.json --board board.toml => words.json: cameras.core.focal_px must be
check cap --rig metres.json --board board.toml => metres.json: units = 'm'
rectify nowhere --rig rig.json --out o => nowhere: no such folder
rectify cap --rig board.toml --out o => board.toml: not JSON
rectify cap --rig rig.json --out cap => --out cap: is an input
rectify cap --rig rig.json --out o --depth-range 500 => expected 2 arguments
rectify cap --rig rig.json --out o --depth-range a b => argument --depth-range: 'a' is not a number
rectify cap --rig rig.json --out o --depth-range 0 800 => both numbers must be positive
reconstruct cap --rig rig.json --out o --preset slow => preset = 'slow' is not known; there are fast
reconstruct cap --rig rig.json --out o --method magic => method magic: unknown; use --method
reconstruct cap --rig rig.json --out o --pair left => pair left: --method binocular pairs core with
reconstruct cap --rig rig.json --out o --depth-range nan 5 => both must be finite numbers
reconstruct cap --rig rig.json --out o --depth-range 5 inf => both must be finite numbers
reconstruct cap/core --rig rig.json --out o => cap/core: no camera folder with images in it
measure belt nowhere --out b.json => nowhere: no such folder; give a reconstruction
measure belt cap --out b.json => cap: no frame folder with a depth.tiff
measure belt text.txt --out b.json => text.txt: is a file; give a reconstruction
measure belt two --out . => --out .: is a folder; give a file, such as belt.json
measure belt two --out dir => --out dir: is a folder; give a file, such as dir/belt.json
measure belt two --out rig.json => --out rig.json: exists and is no belt.json
measure belt two --out text.txt => --out text.txt: must end in .json; give text.json
measure belt two --out b.html => --out b.html: must end in .json
measure belt cut --out text.txt/b.json => cut/000/depth.tiff: not a readable TIFF
measure belt two --frames 009 --out b.json => two/009: no such folder
measure belt norig --out b.json => norig/000: no rig.json lies beside this frame, in norig
measure volume nowhere --empty two => nowhere: no such folder; give a frame folder
measure volume two --empty two => two: holds the frames 000, 001; give one of them, such as two/000
measure volume dir --empty two => dir: holds no depth.tiff, nor folders with one
measure volume cap --empty two => cap: holds images, not depths; give a folder of beltscape reconstruct
measure volume two/000/depth.tiff --empty two => two/000/depth.tiff: is a file; give the frame folder
measure volume cut --empty two => cut/000/depth.tiff: not a readable TIFF
measure volume "zer ö" --empty two => zer ö/000/sigma.tiff: not a readable TIFF
measure volume nosigma --empty two => nosigma/000/sigma.tiff: no such file
measure volume norig/000 --empty two => norig/000: no rig.json lies beside this frame
measure volume two/000 --empty nope.json => nope.json: no such file or folder; give a belt.json
measure volume two/000 --empty rig.json => rig.json: format is 'beltscape-rig/1', not 'beltscape-belt/1'
measure volume two/000 --empty text.txt => text.txt: not JSON
measure volume two/000 --empty dir => dir: holds no depth.tiff
measure volume two/000 --empty two --across 5 1 => --across 5 1: the first number must be the smaller
measure volume two/000 --empty two --along nan 1 => --along nan 1: both must be finite
measure volume two/000 --empty two --cell nan => --cell nan: must be a finite number
measure volume two/000 --empty two --profile-every 1e-9 => --profile-every 1e-09: cannot be the distance of two
measure volume two/000 --empty two --surcharge 95 => --surcharge 95: must be
measure volume two/000 --empty two --out two/000 => --out two/000: is an input
measure volume two/000 => the following arguments are required: --empty
measure lumps nowhere => nowhere: no such folder
measure lumps two => two: holds the frames 000, 001
measure lumps two/000 --empty rig.json => rig.json: format is 'beltscape-rig/1'
measure lumps two/000 --sieves a,b => --sieves a,b: give apertures in mm
measure lumps two/000 --sieves 20,10 => --sieves 20,10: sieves must ascend
measure lumps two/000 --oversize nan => --oversize nan: must be a finite number
measure lumps two/000 --oversize 0.15 => --oversize 0.15: cannot be the size of a lump in mm (1 to 3000); in metres?
measure lumps two/000 --sieves 0.01,0.02 => --sieves 0.01: cannot be the aperture of a sieve
measure volume two/000 --empty two --along -0.2 0.2 => in metres? write -200 200
measure volume two/000 --empty two --across -0.2 0.2 => --across -0.2 0.2: 0.4 mm is no box on a belt (5 mm and more)
measure volume two/000 --empty two --cell 0.002 => --cell 0.002: cannot be the edge of a cell in mm (0.02 to 100)
measure volume two/000 --empty two --profile-every 0.05 => --profile-every 0.05: cannot be
measure volume two/000 --empty two --profile-every 0,05 => '0,05' is not a number, with a decimal point
{FLOW} --out o --load 0.2 => --load 0.2: cannot be the height of a load in mm (2 to 5000); in metres? write 200
{FLOW} --out o --density 1.6 => --density 1.6: cannot be a bulk density in kg/m³ (5 to 30000); in t/m³? write 1600
plan --belt-width 0.8 => belt.width_mm = 0.8: cannot be a width of belt in mm (20 to 20000); in metres? write 800
plan --speed 2000 => belt.speed_m_s = 2000.0: cannot be the speed of a belt in m/s (0.005 to 20); in mm/s? write 2
plan --speed 120 => in m/min? write 2
plan --focal 0.008 => camera.focal_mm = 0.008: must be greater than or equal to 1; in metres? write 8
plan --angle 0.99 => camera.angle_deg = 0.99: must be greater than 1; in radians? write 56.72
simulate module --height 0.744 --out o => rig.height_mm = 0.744: cannot be the height of a camera
target board --corners 8 5 --square 0.03 --out o => square_mm = 0.03: cannot be the edge of a board's square in mm
measure features nowhere --module module.toml => nowhere: no such folder
measure features two/000 --module nope.toml => nope.toml: no such file
measure features two/000 --module board.toml => board.toml: unknown key kind; known: name, base
measure features two/000 --module module.toml --image text.txt => text.txt: not a readable image
{FLOW} --out o --encoder nope.csv => nope.csv: no such file
{FLOW} --out o --encoder bad.csv => bad.csv: line 3: timestamp_s 'x' is not a number
{FLOW} --out o --encoder empty.json => empty.json: the header is ''
{FLOW} --out o --density nan => --density nan: must be a finite number
{FLOW} --out o --density-table bad.csv => bad.csv: the header is 'frame,timestamp_s,belt_position_mm'
{FLOW} --out o --product x => --product NAME goes with --products FILE
{FLOW} --out o --direction up => --direction up: must be '+y' or '-y'
{FLOW} --out o --load nan => --load nan: must be a finite number
{FLOW} --out o --frames-per-s 0 => --frames-per-s 0: must be greater than 0
{FLOW} --out cap/flow => --out cap/flow: lies in the capture cap
measure weight two => invalid choice: 'weight'
view nowhere --out s.html => nowhere: holds neither rig.json nor frames
view text.txt --out s.html => text.txt: not JSON
view two --out . => --out .: is a folder; give a file, such as scene.html
view two --out rig.json => --out rig.json: exists and is no .html file
view two --belt rig.json --out s.html => rig.json: holds no pose belt_from_core
view two --features list.json --out s.html => list.json: is no features.json
plan --plan nope.toml => nope.toml: no such file
plan --plan board.toml => board.toml: unknown key kind
plan --belt-width nan => belt.width_mm = nan: must be a finite number
plan --out cap => cap: holds core, left, which beltscape plan did not write; choose a new or empty --out
{BOARD.replace("22", "40")} --out o => marker_mm = 40 must be smaller than square_mm = 30
{BOARD.replace("5X5_100", "9")} --out o => no ArUco dictionary is called DICT_9
{BOARD} --page A9 --out o => page 'A9' is not known; give A4
{BOARD} --out cap => cap: holds core, left, which beltscape target board did not write
target pattern --dots 0 --out o => count = 0: must be
target pattern --dots 10 --out text.txt => text.txt is a file, not a folder
simulate nothing --out o => nothing: no such scene
simulate board.toml --out o => board.toml: unknown key corners
simulate module --rig board.toml --out o => board.toml: not JSON
simulate module --out cap => cap: holds core, left, which beltscape simulate module did not write
demo --out cap => cap: holds core, left, which beltscape demo did not write
evaluate depth two --truth nowhere => nowhere: no such truth
evaluate depth two --truth text.txt => text.txt: not a truth's npz file; give
evaluate lumps two/000 --truth nowhere => nowhere: no such folder; give truth/
evaluate paper --captures dir --out o => dir/calibration: no such capture
export rig.json --format opencv --out . => --out .: is a folder; give a file, such as rig.yaml
export rig.json --format opencv --out board.toml => --out board.toml: exists and is no .yaml file
export rig.json --format ros --out cap => cap: holds core, left, which beltscape export did not write
export board.toml --format opencv --out o.yaml => board.toml: not JSON
import dir --out r.json => dir: holds no .yaml file
import text.txt --out . => --out .: is a folder; give a file, such as rig.json
import text.txt --out r.yaml => --out r.yaml: must end in .json; give r.json
import rig.json --out r.json => rig.json: is a rig.json of Beltscape already
run dir --check => dir: cannot be read (Is a directory)
run board.toml --check => board.toml: unknown key kind
replay nope.toml --out o => nope.toml: no such file
replay project.toml --capture nowhere --out o => nowhere: no such folder
replay project.toml --out cap => cap: holds core, left, which beltscape replay did not write
cameras --check nope.toml => nope.toml: no such file
cameras --check project.toml => project.toml: it has no table [cameras]
users list nowhere => nowhere: no such file
"""


@pytest.fixture(scope="module")
def desk(tmp_path_factory) -> Path:
    """Small files of every kind, sound and broken ones."""
    desk = tmp_path_factory.mktemp("a desk ü")
    eye = camera(200, 160, 230.0)
    aside = Pose(np.eye(3), np.array([-150.0, 0.0, 0.0]))
    rig = Rig("core", {"core": eye, "left": eye}, {"core": Pose.identity(), "left": aside})
    write_rig(desk / "rig.json", rig)
    depth, _ = render_depth_map(make_ellipsoids(np.random.default_rng(4), columns=3, rows=3), eye)
    points = depth.points_mm(eye)[depth.measured].astype(np.float32)
    cloud = PointCloud(points, points, np.full(points.shape, 90, np.uint8), depth.sigma_mm[depth.measured])
    write_rig(desk / "two" / "rig.json", rig)
    for name in ("000", "001"):
        write_frame(desk / "two" / name, depth, cloud, np.zeros((4, 4, 3), np.uint8))
    for name in ("cut", "zer ö", "norig", "nosigma"):
        shutil.copytree(desk / "two" / "000", desk / name / "000")
        shutil.copy(desk / "rig.json", desk / name)
    whole = (desk / "cut" / "000" / "depth.tiff").read_bytes()
    (desk / "cut" / "000" / "depth.tiff").write_bytes(whole[:3000])
    (desk / "zer ö" / "000" / "sigma.tiff").write_bytes(b"")
    (desk / "norig" / "rig.json").unlink()
    (desk / "nosigma" / "000" / "sigma.tiff").unlink()
    for name in ("core", "left"):
        (desk / "cap" / name).mkdir(parents=True)
        shutil.copy(desk / "two" / "000" / "preview.png", desk / "cap" / name / "000.png")
    _write_texts(desk, json.loads((desk / "rig.json").read_text()))
    return desk


def _write_texts(desk: Path, rig: dict) -> None:
    (desk / "dir").mkdir()
    (desk / "broken").symlink_to("nowhere")
    (desk / "metres.json").write_text(json.dumps({**rig, "units": "m"}))
    rig["cameras"]["core"]["focal_px"] = "long"
    (desk / "words.json").write_text(json.dumps(rig))
    (desk / "bin.json").write_bytes(b"\xff\xfe\x00")
    for name, text in {
        "empty.json": "",
        "list.json": "[]",
        "text.txt": "hello",
        "bad.csv": "frame,timestamp_s,belt_position_mm\n000,0,0\n001,x,5\n",
        "board.toml": 'kind = "chessboard"\ncorners = [8, 5]\nsquare_mm = 40\n',
        "module.toml": "[base]\nsize_mm = [285, 200, 10]\n",
        "project.toml": 'rig = "rig.json"\nempty = "two"\n[capture]\nfolder = "cap"\n',
    }.items():
        (desk / name).write_text(text)


@pytest.mark.parametrize("case", CASES.strip().splitlines())
def test_bad_input_is_one_line_and_leaves_nothing(desk, monkeypatch, capfd, case):
    words, says = case.split(" => ")
    monkeypatch.chdir(desk)
    before = {path: path.lstat().st_mtime_ns for path in desk.rglob("*")}
    code = main([*shlex.split(words), "--json"])
    out, err = capfd.readouterr()
    lines = [
        line for line in err.splitlines() if not line.endswith(" done") and not line.startswith("warning: ")
    ]
    assert (code, len(lines)) == (2, 1), err
    assert says in lines[0]
    error = json.loads(out)["error"]
    assert lines[0] == f"beltscape: {error['message']}" or lines[0] == error["message"]
    assert error["exit_code"] == 2
    assert {path: path.lstat().st_mtime_ns for path in desk.rglob("*")} == before
