"""Images in every format: values, colours and bit depths."""

from __future__ import annotations

import os
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
import pytest

from beltscape.core.errors import InputError
from beltscape.files.images import KINDS, encode_image, read_image, write_image

RED, BLUE = (255, 0, 0), (0, 128, 255)


def noise(dtype, *shape: int) -> np.ndarray:
    return np.random.default_rng(1).integers(0, np.iinfo(dtype).max, shape, dtype=dtype, endpoint=True)


def two_colours() -> PIL.Image.Image:
    pixels = np.empty((8, 10, 3), np.uint8)
    pixels[:, :5], pixels[:, 5:] = RED, BLUE
    return PIL.Image.fromarray(pixels)


@pytest.mark.parametrize("extension", [".png", ".tif", ".tiff", ".PNG"])
@pytest.mark.parametrize("shape", [(13, 17), (13, 17, 3)], ids=["grey", "rgb"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_images_read_back_unchanged(tmp_path, extension, shape, dtype):
    image = noise(dtype, *shape)
    write_image(tmp_path / f"a{extension}", image)
    back = read_image(tmp_path / f"a{extension}")
    assert back.dtype == dtype
    assert back.flags.c_contiguous
    np.testing.assert_array_equal(back, image)


def test_bmp_is_lossless_and_jpeg_nearly(tmp_path):
    image = cv2.GaussianBlur(noise(np.uint8, 40, 40, 3), (0, 0), 8)
    write_image(tmp_path / "a.bmp", image)
    write_image(tmp_path / "a.jpg", image)
    np.testing.assert_array_equal(read_image(tmp_path / "a.bmp"), image)
    assert np.abs(read_image(tmp_path / "a.jpg").astype(int) - image).max() < 16


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "P"])
@pytest.mark.parametrize("extension", [".png", ".tif"])
def test_colours_are_rgb_for_every_format(tmp_path, mode, extension):
    two_colours().convert(mode, palette=PIL.Image.Palette.ADAPTIVE).save(tmp_path / f"a{extension}")
    image = read_image(tmp_path / f"a{extension}")
    assert image.shape == (8, 10, 3)
    assert (tuple(image[0, 0]), tuple(image[-1, -1])) == (RED, BLUE)


def test_one_bit_images_are_read_as_black_and_white(tmp_path):
    PIL.Image.fromarray(np.eye(9, dtype=np.uint8) * 255).convert("1").save(tmp_path / "a.png")
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), np.eye(9) * 255)


def test_a_16_bit_tiff_of_another_program_keeps_its_counts(tmp_path):
    import tifffile

    image = noise(np.uint16, 12, 9)
    tifffile.imwrite(tmp_path / "a.tif", image, compression="zlib")
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), image)


def test_an_empty_file_is_named(tmp_path):
    (tmp_path / "a.png").touch()
    with pytest.raises(InputError) as error:
        read_image(tmp_path / "a.png")
    assert str(error.value) == f"{tmp_path}/a.png: the file is empty (0 bytes); copy the image again"


@pytest.mark.parametrize("share", [0.001, 0.1, 0.5, 0.99, 0.9999])
@pytest.mark.parametrize("extension", [".png", ".tif", ".jpg", ".bmp"])
def test_a_truncated_image_is_refused_not_half_read(tmp_path, capfd, extension, share):
    data = encode_image(noise(np.uint8, 160, 160), extension)
    path = tmp_path / f"a{extension}"
    path.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(InputError) as error:
        read_image(path)
    assert str(error.value) in (
        f"{path}: not a readable image; {KINDS} are known",
        f"{path}: the file is damaged or cut short; copy the image again",
    )
    assert capfd.readouterr() == ("", "")  # nor does OpenCV say a word


@pytest.mark.parametrize("place", [30, 5000, -20, -2])
def test_a_png_with_a_flipped_bit_is_refused(tmp_path, capfd, place):
    data = bytearray(encode_image(noise(np.uint8, 160, 160)))
    data[place] ^= 4
    (tmp_path / "a.png").write_bytes(data)
    with pytest.raises(InputError) as error:
        read_image(tmp_path / "a.png")
    assert str(error.value) == f"{tmp_path}/a.png: the file is damaged or cut short; copy the image again"
    assert capfd.readouterr() == ("", "")


def test_text_named_png_is_refused(tmp_path):
    (tmp_path / "a.png").write_text("hello")
    with pytest.raises(InputError) as error:
        read_image(tmp_path / "a.png")
    assert str(error.value) == f"{tmp_path}/a.png: not a readable image; {KINDS} are known"


def test_a_missing_file_or_a_folder_is_named(tmp_path):
    (tmp_path / "a.png").mkdir()
    with pytest.raises(InputError) as folder:
        read_image(tmp_path / "a.png")
    with pytest.raises(InputError) as missing:
        read_image(tmp_path / "b.png")
    assert str(folder.value) == f"{tmp_path}/a.png: cannot be read (Is a directory)"
    assert str(missing.value) == f"{tmp_path}/b.png: cannot be read (No such file or directory)"


def test_float_images_are_refused(tmp_path):
    import tifffile

    tifffile.imwrite(tmp_path / "a.tif", np.zeros((4, 4), np.float32))
    with pytest.raises(InputError) as error:
        read_image(tmp_path / "a.tif")
    assert str(error.value) == f"{tmp_path}/a.tif: pixels are float32; 8 or 16 bit images are needed"


@pytest.mark.parametrize(
    ("dtype", "extension", "message"),
    [
        (np.uint16, ".jpg", "uint16 images cannot be stored as '.jpg'; use .png, .tif, .tiff"),
        (np.uint16, ".bmp", "uint16 images cannot be stored as '.bmp'; use .png, .tif, .tiff"),
        (
            np.uint8,
            ".xyz",
            "uint8 images cannot be stored as '.xyz'; use .png, .tif, .tiff, .jpg, .jpeg, .bmp",
        ),
    ],
)
def test_no_format_drops_bits_in_silence(dtype, extension, message):
    with pytest.raises(InputError) as error:
        encode_image(np.zeros((4, 4), dtype), extension)
    assert str(error.value) == message


@pytest.mark.parametrize("extension", [".pgm", ".ppm", ".pnm", ".webp", ".jp2"])
def test_images_of_machine_vision_tools_are_read(tmp_path, extension):
    image = cv2.GaussianBlur(noise(np.uint8, 64, 80), (0, 0), 6)
    stored = image if extension == ".pgm" else np.dstack([image] * 3)
    (tmp_path / f"a{extension}").write_bytes(cv2.imencode(extension, stored)[1].tobytes())
    read = read_image(tmp_path / f"a{extension}")
    assert np.abs(read.astype(int) - (image if read.ndim == 2 else image[..., None])).max() <= 2


def test_a_16_bit_pgm_keeps_its_counts(tmp_path):
    image = noise(np.uint16, 12, 9)
    (tmp_path / "a.pgm").write_bytes(b"P5\n9 12\n65535\n" + image.astype(">u2").tobytes())
    np.testing.assert_array_equal(read_image(tmp_path / "a.pgm"), image)


@pytest.mark.parametrize("kind", ["TIFF", "GIF", "WEBP", "PNG"])
@pytest.mark.parametrize("pages", [1, 3])
def test_an_image_file_of_several_pages_is_refused_with_their_number(tmp_path, kind, pages):
    frames = [PIL.Image.fromarray(np.full((8, 10), 60 * i, np.uint8)) for i in range(pages)]
    frames[0].save(tmp_path / "a.tif", kind, save_all=pages > 1, append_images=frames[1:])
    if pages == 1:
        assert read_image(tmp_path / "a.tif").shape[:2] == (8, 10)
        return
    with pytest.raises(
        InputError, match=f"a.tif: holds {pages} pages, and an image file is one frame; save each"
    ):
        read_image(tmp_path / "a.tif")


def test_a_tiff_with_a_thumbnail_is_one_image(tmp_path):
    import tifffile

    image = noise(np.uint8, 40, 60)
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        file.write(image)
        file.write(image[::4, ::4], subfiletype=1)
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), image)
    buffer = BytesIO()
    tifffile.imwrite(buffer, np.stack([image, image]), bigtiff=True)
    (tmp_path / "b.tif").write_bytes(buffer.getvalue())
    with pytest.raises(InputError, match="holds 2 pages"):
        read_image(tmp_path / "b.tif")


def test_a_pipe_is_refused_without_being_opened(tmp_path):
    os.mkfifo(tmp_path / "a.png")
    with pytest.raises(InputError, match=r"a\.png: is a pipe, socket or device, which is not opened"):
        read_image(tmp_path / "a.png")


@pytest.mark.parametrize("extension", [".png", ".tiff"])
def test_an_image_of_12_bits_fills_the_range_of_16(tmp_path: Path, extension: str) -> None:
    """Read as they stand, its levels were judged a sixteenth as bright: frames were refused as too dark."""
    stored = np.random.default_rng(0).integers(0, 4096, (20, 30), np.uint16)
    stored[0, :2] = 0, 4095
    write_image(tmp_path / f"low{extension}", stored)
    image = read_image(tmp_path / f"low{extension}")
    assert image[0, :2].tolist() == [0, 65535]
    np.testing.assert_allclose(image / 65535, stored / 4095, atol=1 / 65535)


@pytest.mark.parametrize(("step", "top"), [(1, 4096), (4, 1023), (16, 255)])
def test_a_dark_image_whose_bits_stand_at_the_top_is_not_changed(tmp_path: Path, step: int, top: int) -> None:
    stored = (step * np.random.default_rng(1).integers(0, top + 1, (20, 30))).astype(np.uint16)
    stored[0, 0] = step * top
    write_image(tmp_path / "dark.png", stored)
    np.testing.assert_array_equal(read_image(tmp_path / "dark.png"), stored)
