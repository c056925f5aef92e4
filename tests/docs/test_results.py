"""A result is taken for the same bytes under any name, and for no others."""

from __future__ import annotations

import pytest

from tests.docs.program import Answer
from tests.docs.results import Results, digest_command


@pytest.fixture
def folder(tmp_path):
    for name, text in (("empty/cam0/000.png", "image"), ("rig.json", "{}"), ("volume/load.tiff", "load")):
        path = tmp_path / "reader" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path / "reader"


def words(text="reconstruct empty --rig rig.json --out depth"):
    return text.split()


def test_names_do_not_matter_but_bytes_do(folder):
    before = digest_command(words(), folder)
    (folder / "empty").rename(folder / "belt")
    renamed = words("reconstruct belt --rig rig.json --out other")
    assert digest_command(renamed, folder) == before
    (folder / "belt/cam0/000.png").write_text("another image")
    assert digest_command(renamed, folder) != before


def test_files_that_a_toml_file_names_count(folder):
    (folder / "scene.toml").write_text('[rig]\nfile = "rig.json"\n')
    before = digest_command(words("simulate scene.toml --out out"), folder)
    (folder / "rig.json").write_text('{"core": "cam1"}')
    assert digest_command(words("simulate scene.toml --out out"), folder) != before


def test_a_subcommand_is_not_the_folder_of_its_name(folder):
    before = digest_command(words("measure volume empty --out volume"), folder)
    (folder / "volume/load.tiff").write_text("another load")
    assert digest_command(words("measure volume empty --out volume"), folder) == before


def test_a_command_runs_once_and_its_output_comes_back(folder, tmp_path):
    calls = []

    def call(command, at):
        calls.append(command)
        (at / "depth").mkdir()
        (at / "depth/depth.tiff").write_text("depth")
        return Answer(0, "measured", "")

    results = Results(tmp_path / "results")
    first = results.obtain(words(), folder, call)
    (folder / "depth/depth.tiff").write_text("changed")
    assert results.obtain(words(), folder, call) == first
    assert len(calls) == 1
    assert (folder / "depth/depth.tiff").read_text() == "depth"


def test_a_failure_is_not_kept(folder, tmp_path):
    answers = iter([Answer(2, "", "no such file"), Answer(0, "done", "")])
    results = Results(tmp_path / "results")
    command = words("check empty --rig rig.json")
    assert results.obtain(command, folder, lambda *_: next(answers)).code == 2
    assert results.obtain(command, folder, lambda *_: next(answers)).code == 0
