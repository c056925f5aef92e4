"""Seals: what was signed is found as such, and any change of a byte, a statement or a key is found."""

from __future__ import annotations

import json
import stat
from pathlib import Path

import pytest

from beltscape.core.errors import InputError
from beltscape.files.seal import open_key, read_public_key, read_sealed

STATEMENT = {"number": "2026-0001", "plant": "quay -- north", "applies": {"rig": "0" * 64}}
PAGE = "<!doctype html><title>Würfel</title></html>\n".encode()
PDF = b"%PDF-1.7\n1 0 obj\nendobj\nxref\ntrailer\nstartxref\n9\n%%EOF\n"
BODIES = {".html": PAGE, ".pdf": PDF}


def write(folder: Path, ending: str) -> Path:
    key, path = open_key(folder), folder / f"sealed{ending}"
    if ending == ".json":
        path.write_text(json.dumps(key.seal_document({"value": 1.5, "text": "ü"}, STATEMENT), indent=3))
    else:
        path.write_bytes(key.seal_bytes(BODIES[ending], STATEMENT, ending))
    return path


@pytest.mark.parametrize("ending", [".html", ".pdf", ".json"])
def test_a_sealed_file_is_intact_and_names_its_key(tmp_path, ending) -> None:
    path = write(tmp_path, ending)
    sealed = read_sealed(path)
    assert sealed.is_intact
    assert sealed.statement == STATEMENT
    assert sealed.public_key == open_key(tmp_path).public_key == read_public_key(tmp_path / "key.pub")


def test_a_page_and_a_pdf_stay_what_they_are(tmp_path) -> None:
    page = write(tmp_path, ".html").read_bytes()
    assert page.startswith(PAGE)
    assert b"--" not in page[len(PAGE) :].strip().removeprefix(b"<!--").removesuffix(b"-->")
    pdf = write(tmp_path, ".pdf").read_bytes()
    assert pdf.startswith(PDF)
    assert pdf.endswith(b"startxref\n9\n%%EOF\n")


@pytest.mark.parametrize("ending", [".html", ".pdf", ".json"])
def test_any_changed_byte_is_found(tmp_path, ending) -> None:
    """One bit is flipped at places all over the file: it is refused, or no longer intact."""
    path = write(tmp_path, ending)
    data = path.read_bytes()
    for at in range(0, len(data), 7):
        changed = bytearray(data)
        changed[at] ^= 1
        path.write_bytes(changed)
        try:
            sealed = read_sealed(path)
        except InputError:
            continue
        blank = ending == ".json" and (data[at : at + 1].isspace() or chr(changed[at]).isspace())
        assert not sealed.is_intact or blank, at


def test_another_statement_or_another_s_key_is_found(tmp_path) -> None:
    path = write(tmp_path, ".json")
    document = json.loads(path.read_text())
    document["seal"]["statement"]["number"] = "2026-0002"
    path.write_text(json.dumps(document))
    assert not read_sealed(path).is_intact
    other = open_key(tmp_path / "other").seal_document({"value": 2}, STATEMENT)
    path.write_text(json.dumps(other))
    assert read_sealed(path).is_intact  # by the other key, which those who trust a key compare
    assert read_sealed(path).public_key != open_key(tmp_path).public_key
    document["seal"]["public_key"] = other["seal"]["public_key"]
    path.write_text(json.dumps(document))
    assert not read_sealed(path).is_intact


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.html", "<html></html>"), ("a.json", "{}"), ("a.json", "[]"), ("a.json", "no JSON"),
        ("a.pdf", "%PDF\n% beltscape-seal {}\n"), ("a.html", "x\n<!-- beltscape-seal [] -->\n"),
    ],
)  # fmt: skip
def test_a_file_without_a_seal_is_one_line(tmp_path, name, content) -> None:
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(InputError, match="has no seal that can be read"):
        read_sealed(path)
    with pytest.raises(InputError, match="cannot be read"):
        read_sealed(tmp_path / "missing.json")


def test_the_key_is_for_its_owner_alone_and_stays(tmp_path) -> None:
    first = open_key(tmp_path).public_key
    assert stat.S_IMODE((tmp_path / "key.pem").stat().st_mode) == 0o600
    assert open_key(tmp_path).public_key == first
    (tmp_path / "key.pem").write_text("damaged")
    with pytest.raises(InputError, match="restore it from a backup"):
        open_key(tmp_path)
    assert (tmp_path / "key.pem").read_text() == "damaged"
    (tmp_path / "key.pub").write_text("AAAA")
    with pytest.raises(InputError, match="no public key"):
        read_public_key(tmp_path / "key.pub")


def test_a_lost_key_is_not_replaced_by_another_one(tmp_path) -> None:
    first = open_key(tmp_path).public_key
    (tmp_path / "key.pub").unlink()
    assert open_key(tmp_path).public_key == first
    assert read_public_key(tmp_path / "key.pub") == first, "a program was killed before it wrote it"
    kept = (tmp_path / "key.pem").read_bytes()
    (tmp_path / "key.pem").unlink()
    with pytest.raises(
        InputError, match=r"key\.pem: is lost, while key\.pub is there; restore it from a backup"
    ):
        open_key(tmp_path)
    assert not (tmp_path / "key.pem").exists()
    open_key(tmp_path / "other")
    (tmp_path / "key.pem").write_bytes((tmp_path / "other/key.pem").read_bytes())
    with pytest.raises(InputError, match=r"key\.pub: is not that of key\.pem"):
        open_key(tmp_path)
    (tmp_path / "key.pem").write_bytes(kept)
    assert open_key(tmp_path).public_key == first
