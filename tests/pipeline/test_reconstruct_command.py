"""``beltscape reconstruct``: files, tolerated and refused input."""

from __future__ import annotations

import contextlib
import io
import json
import shutil

import cv2
import numpy as np
import pytest
import tifffile

from beltscape.cli.main import main
from beltscape.files.images import read_image
from beltscape.files.ply import read_cloud
from beltscape.files.rig_json import read_rig
from tests.synthetic.demo import DEMO, TRUE_RIG, parse_json


def warnings(lines):
    return [line for line in lines if line.startswith("warning: ")]


def last(lines):
    return [line for line in lines if not line.startswith("warning: ") and ": " in line][-1]


@pytest.fixture(scope="module")
def reconstructed(small_demo, small_rig, tmp_path_factory):
    """The document and the folder of the module by the fast preset; nobody writes into it."""
    out = tmp_path_factory.mktemp("reconstructed") / "r"
    words = ["reconstruct", small_demo / "module", "--rig", small_rig, "--out", out, "--preset", "fast"]
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        assert main([*map(str, words), "--json"]) == 0
    return parse_json(printed.getvalue()), out


def check_contract(document, out, small_rig, method, auxiliaries):
    assert set(document) == {"method", "auxiliaries", "depth_range_mm", "regions", "frames", "warnings"}
    assert set(document["frames"][0]) == {
        "frame", "folder", "coverage", "median_depth_mm", "median_sigma_mm",
        "auxiliaries", "systematic_mm", "doubts", "consistency", "health",
    }  # fmt: skip
    assert not any(finding["text"] for finding in document["frames"][0]["health"])
    frame = out / "000"
    assert document["frames"][0]["folder"] == str(frame)
    assert document["method"] == method
    assert document["auxiliaries"] == auxiliaries
    rig = read_rig(out / "rig.json")
    assert (out / "rig.json").read_bytes() == small_rig.read_bytes()
    depth, sigma = tifffile.imread(frame / "depth.tiff"), tifffile.imread(frame / "sigma.tiff")
    width, height = rig.core_camera.size_px
    assert depth.shape == sigma.shape == (height, width)
    assert depth.dtype == sigma.dtype == np.float32
    np.testing.assert_array_equal(cv2.imread(str(frame / "depth.tiff"), cv2.IMREAD_UNCHANGED), depth)
    measured = np.isfinite(depth)
    assert np.array_equal(measured, np.isfinite(sigma))
    assert (sigma[measured] > 0).all()
    cloud = read_cloud(frame / "cloud.ply")
    assert len(cloud.points_mm) == measured.sum()
    np.testing.assert_array_equal(cloud.points_mm[:, 2], depth[measured])
    assert read_image(frame / "preview.png").shape[2] == 3


def test_answer_and_files_follow_the_contract(reconstructed, small_rig):
    document, out = reconstructed
    check_contract(document, out, small_rig, "multiview", ["cam1", "cam3"])


def test_answer_and_files_of_one_pair_follow_the_contract(run, small_demo, small_rig, tmp_path):
    words = ("reconstruct", small_demo / "module", "--rig", small_rig, "--out", tmp_path / "r")
    code, out, _ = run(*words, "--method", "binocular", "--json")
    assert code == 0
    check_contract(parse_json(out), tmp_path / "r", small_rig, "binocular", ["cam3"])


def test_files_are_deterministic(run, reconstructed, small_demo, small_rig, tmp_path):
    _, first = reconstructed
    run("reconstruct", small_demo / "module", "--rig", small_rig, "--out", tmp_path / "r", "--preset", "fast")
    paths = sorted(first.rglob("*.*"))
    assert len(paths) > 8
    for path in paths:
        assert path.read_bytes() == (tmp_path / "r" / path.relative_to(first)).read_bytes(), path.name


def test_missing_camera_causes_a_warning(run, small_capture, small_rig, tmp_path):
    folder = small_capture("module")
    shutil.rmtree(folder / "cam3")
    code, out, err = run("reconstruct", folder, "--rig", small_rig, "--out", tmp_path / "r", "--json")
    line = f"{folder / 'cam3'}: no images of camera cam3; going on without it"
    assert code == 0
    assert warnings(err) == [f"warning: {line}"]
    assert parse_json(out)["warnings"] == [line]
    assert parse_json(out)["auxiliaries"] == ["cam1"]


def test_empty_image_causes_a_warning(run, small_capture, small_rig, tmp_path):
    folder = small_capture("module")
    (folder / "cam1" / "000.png").write_bytes(b"")
    code, _, err = run("reconstruct", folder, "--rig", small_rig, "--out", tmp_path / "r")
    assert code == 0
    assert warnings(err) == [
        f"warning: {folder / 'cam1' / '000.png'}: the file is empty (0 bytes); copy the image again; "
        "going on without this image"
    ]


def test_image_of_another_size_causes_a_warning(run, small_capture, small_rig, tmp_path):
    folder = small_capture("module")
    cv2.imwrite(str(folder / "cam3" / "000.png"), np.zeros((80, 120), np.uint8))
    code, _, err = run("reconstruct", folder, "--rig", small_rig, "--out", tmp_path / "r")
    assert code == 0
    assert warnings(err) == [
        f"warning: {folder / 'cam3'}: images are 120×80 px, the rig's cam3 has 306×256: they are cropped, or of "
        "another camera; images of the whole sensor, or binned in both directions alike, fit the rig; for these, "
        "calibrate with images of the same region; going on without these images",
        f"warning: {folder / 'cam3' / '000.png'}: 120×80 px, but the rig's cam3 has 306×256; "
        "going on without this image",
    ]


def test_unusable_frame_is_skipped_with_a_warning(run, small_capture, small_rig, tmp_path):
    folder = small_capture("module")
    for camera in folder.iterdir():
        shutil.copy(camera / "000.png", camera / "001.png")
    (folder / "cam0" / "001.png").write_bytes(b"no image")
    code, out, err = run("reconstruct", folder, "--rig", small_rig, "--out", tmp_path / "r", "--json")
    assert code == 0
    assert [frame["frame"] for frame in parse_json(out)["frames"]] == ["000"]
    assert not (tmp_path / "r" / "001").exists()
    assert any("001.png: not a readable image" in line for line in warnings(err))


@pytest.mark.parametrize("command", ["reconstruct", "rectify"])
def test_overexposed_view_causes_one_warning_of_its_exposure(
    run, small_capture, small_rig, tmp_path, command
):
    folder = small_capture("module")
    image = read_image(folder / "cam1" / "000.png")
    image[: image.shape[0] // 2] = 255
    cv2.imwrite(str(folder / "cam1" / "000.png"), image)
    code, _, err = run(command, folder, "--rig", small_rig, "--out", tmp_path / "r")
    assert code == 0
    assert (
        warnings(err)
        == [
            "warning: frame 000: cam1: 50 % of its pixels are saturated: expose shorter, "
            "or shade the belt from the sun",
            "warning: frame 000: cam1: its brightness is 21 times that of the other cameras: "
            "correct exposure, gain or aperture, or clean its window",
            "warning: frame 000: no camera shows texture above its noise: "  # the speckle of the others is blurred
            "is the projector on and in focus, is there light?",
        ]
    )


def test_low_coverage_causes_a_warning(run, small_capture, small_rig, tmp_path):
    folder = small_capture("module")
    for path in folder.glob("*/*.png"):
        image = read_image(path)
        image[:, : image.shape[1] // 3] = image[:, -image.shape[1] // 2 :] = 0
        cv2.imwrite(str(path), image)
    code, out, err = run("reconstruct", folder, "--rig", small_rig, "--out", tmp_path / "r", "--json")
    assert code == 0
    share = parse_json(out)["frames"][0]["coverage"]
    assert share < 0.3
    lines = warnings(err)
    assert [line.split(": ")[2] for line in lines[:3]] == ["cam0", "cam1", "cam3"]
    assert all("its image is too dark" in line for line in lines[:3])
    assert lines[3:] == [
        "warning: frame 000: no camera shows texture above its noise: "
        "is the projector on and in focus, is there light?",
        f"warning: frame 000: only {share:.0%} of the pixels are measured: cam0's image has hardly any texture "
        "(38 textured points); is the speckle projector on and in focus, and the exposure long enough?",
    ]


def test_capture_without_the_core_is_refused(run, small_capture, small_rig, tmp_path):
    folder = small_capture("module")
    shutil.rmtree(folder / "cam0")
    code, out, err = run("reconstruct", folder, "--rig", small_rig, "--out", tmp_path / "r")
    assert (code, out) == (2, "")
    assert err == [
        f"beltscape: {folder / 'cam0'}: no images of the core camera cam0; the capture has cam1, cam3"
    ]


def test_capture_without_auxiliaries_is_refused(run, small_capture, small_rig, tmp_path):
    folder = small_capture("module")
    for name in ("cam1", "cam3"):
        shutil.rmtree(folder / name)
    code, _, err = run("reconstruct", folder, "--rig", small_rig, "--out", tmp_path / "r")
    assert code == 2
    assert err == [
        f"beltscape: {folder}: no images of an auxiliary camera of the rig (cam1, cam3); "
        "depth needs a second view"
    ]


def test_unusable_core_image_is_refused_by_name(run, small_capture, small_rig, tmp_path):
    folder = small_capture("module")
    (folder / "cam0" / "000.png").write_bytes(b"")
    code, _, err = run("reconstruct", folder, "--rig", small_rig, "--out", tmp_path / "r")
    assert code == 2
    assert last(err) == (
        "beltscape: frame 000: no usable image of the core camera cam0; depth is measured in its view"
    )


@pytest.mark.thorough
def test_standard_is_at_least_as_accurate_as_fast(run, tmp_path):
    truth = tifffile.imread(DEMO / "truth" / "module_depth.tiff")
    median_mm = []
    for preset in ("fast", "standard"):
        out = tmp_path / preset
        words = ("reconstruct", DEMO / "module", "--rig", TRUE_RIG, "--out", out, "--method", "multiview")
        assert run(*words, "--preset", preset, "--depth-range", 590, 780)[0] == 0
        error = np.abs(tifffile.imread(out / "000" / "depth.tiff") - truth)
        assert np.isfinite(error).mean() > 0.8
        assert (error[np.isfinite(error)] > 5).mean() < 0.02
        median_mm.append(np.nanmedian(error))
    assert median_mm[1] <= 1.02 * median_mm[0] < 0.1  # on images this small both match every pixel


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--preset", "best"), "preset = 'best' is not known; there are fast, standard"),
        (("--method", "best"), "method best: unknown; use --method multiview, pairwise, binocular"),
    ],
)
def test_unknown_method_or_preset_is_refused_before_anything_is_written(
    run, small_demo, small_rig, tmp_path, options, message
):
    code, out, err = run(
        "reconstruct", small_demo / "module", "--rig", small_rig, "--out", tmp_path / "r", *options
    )
    assert (code, out) == (2, "")
    assert err == [f"beltscape: {message}"]
    assert not (tmp_path / "r").exists()


def test_rig_of_another_format_is_refused(run, small_demo, small_rig, tmp_path):
    rig = tmp_path / "rig.json"
    rig.write_text(json.dumps({**json.loads(small_rig.read_text()), "format": "kalibr"}))
    code, _, err = run("reconstruct", small_demo / "module", "--rig", rig, "--out", tmp_path / "r")
    assert code == 2
    assert err == [
        f"beltscape: {rig}: format is 'kalibr', not 'beltscape-rig/1'; give a rig.json of beltscape calibrate"
    ]


def test_unwritable_output_is_refused(run, small_demo, small_rig, tmp_path):
    (tmp_path / "file").touch()
    out = tmp_path / "file" / "r"
    code, _, err = run("reconstruct", small_demo / "module", "--rig", small_rig, "--out", out)
    assert code == 2
    assert err == [
        f"beltscape: {out}: cannot be written ({tmp_path / 'file'} is a file, not a folder); "
        "choose another output folder"
    ]


def test_impossible_depth_range_is_refused(run, small_demo, small_rig, tmp_path):
    words = (
        "reconstruct",
        small_demo / "module",
        "--rig",
        small_rig,
        "--out",
        tmp_path / "r",
        "--depth-range",
    )
    assert run(*words, 900, 700)[2] == [
        "beltscape: --depth-range 900 700: the first number must be the smaller one"
    ]
    assert run(*words, -5, 700)[2] == ["beltscape: --depth-range -5 700: both numbers must be positive"]
