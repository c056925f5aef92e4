"""Output folders belong to the command that wrote them: replaced as a whole, foreign ones refused."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from beltscape.core.errors import InputError, OutputError
from beltscape.files import output_folder as module
from beltscape.files.atomic import output_error, write_text
from beltscape.files.output_folder import (
    MANIFEST,
    STAGING,
    add_file,
    continued_folder,
    owned_folder,
    read_manifest,
    require_finished,
)


def put(out: Path, *names: str, command: str = "reconstruct", text: str = "new") -> None:
    with owned_folder(out, command) as staging:
        for name in names:
            write_text(staging / name, text)


def read_files(out: Path) -> dict[str, str]:
    """Relative path → text of everything below but the manifest."""
    files = (path for path in out.rglob("*") if path.is_file() and path.name != MANIFEST)
    return {path.relative_to(out).as_posix(): path.read_text() for path in files}


def test_a_run_replaces_what_the_earlier_one_wrote_and_keeps_the_users_files(tmp_path):
    out = tmp_path / "a" / "b"
    put(out, "rig.json", "000/depth.tiff", "001/depth.tiff", text="old")
    (out / "notes.txt").write_text("mine")
    (out / "001" / "marked.png").write_text("mine")
    (out / "volume").mkdir()
    (out / "volume" / "volume.json").write_text("mine")
    put(out, "rig.json", "000/depth.tiff")
    assert read_files(out) == {
        "rig.json": "new",
        "000/depth.tiff": "new",
        "notes.txt": "mine",
        "001/marked.png": "mine",
        "volume/volume.json": "mine",
    }
    put(out, "rig.json")
    assert not (out / "000").exists()
    manifest = read_manifest(out)
    assert manifest is not None
    assert (manifest.command, manifest.files, manifest.complete) == ("reconstruct", ("rig.json",), True)


def test_a_failure_changes_nothing_and_leaves_no_folder(tmp_path):
    put(tmp_path / "kept", "rig.json", text="old")
    before = sorted(tmp_path.rglob("*"))
    for out in ("kept", "made/for/nothing"):
        with pytest.raises(ZeroDivisionError), owned_folder(tmp_path / out, "reconstruct") as staging:
            write_text(staging / "rig.json", "new")
            raise ZeroDivisionError
    assert sorted(tmp_path.rglob("*")) == before
    assert read_files(tmp_path / "kept") == {"rig.json": "old"}


def test_what_explains_a_failure_lies_beside_the_earlier_result_until_the_next_one(tmp_path):
    out = tmp_path / "out"
    with owned_folder(out, "calibrate") as staging:
        write_text(staging / "rig.json", "1")
    assert add_file(out, "calibrate", "why.png", b"picture").read_bytes() == b"picture"
    assert (out / "rig.json").read_text() == "1"
    with owned_folder(out, "calibrate") as staging:
        write_text(staging / "rig.json", "2")
    assert not (out / "why.png").exists()
    assert (out / "rig.json").read_text() == "2"


def test_the_same_files_give_the_same_bytes(tmp_path):
    for out in ("a", "b"):
        put(tmp_path / out, "z", "ä/β", "m n")
    assert (tmp_path / "a" / MANIFEST).read_bytes() == (tmp_path / "b" / MANIFEST).read_bytes()


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (
            ["photo.jpg"],
            "holds photo.jpg, which beltscape reconstruct did not write; choose a new or empty --out",
        ),
        (["a", "b", "c", "d", "e"], "holds a, b, c and 2 more, which"),
        (
            ["rig.json", "000/depth.tiff"],
            "holds 000, rig.json, written without a manifest, as by an earlier version",
        ),
        (["truth/scenario.json"], "written without a manifest"),
    ],
)
def test_a_foreign_folder_is_refused_and_stays_as_it_was(tmp_path, names, message):
    for name in names:
        write_text(tmp_path / "out" / name, "theirs")
    with pytest.raises(OutputError) as error:
        put(tmp_path / "out", "rig.json")
    assert str(error.value).startswith(f"{tmp_path / 'out'}: ")
    assert message in str(error.value)
    assert read_files(tmp_path / "out") == dict.fromkeys(names, "theirs")


def test_the_folder_of_another_command_is_refused(tmp_path):
    put(tmp_path, "rig.json", command="calibrate")
    with pytest.raises(
        OutputError, match="holds what beltscape calibrate wrote; choose another --out for beltscape"
    ):
        put(tmp_path, "rig.json", command="plan")


def test_hidden_files_do_not_make_a_folder_foreign(tmp_path):
    (tmp_path / ".git").mkdir()
    put(tmp_path, "rig.json")
    assert (tmp_path / ".git").is_dir()


def test_a_users_file_in_the_way_is_not_replaced(tmp_path):
    put(tmp_path, "rig.json", text="old")
    (tmp_path / "report.html").write_text("mine")
    with pytest.raises(OutputError, match=r"report\.html: lies where beltscape reconstruct writes"):
        put(tmp_path, "rig.json", "report.html")
    assert read_files(tmp_path) == {"rig.json": "old", "report.html": "mine"}


@pytest.mark.parametrize("manifest", ["", "[]", '{"format": "other/1"}', '{"format": "beltscape-output/1"}'])
def test_a_damaged_manifest_is_named(tmp_path, manifest):
    (tmp_path / MANIFEST).write_text(manifest)
    with pytest.raises(OutputError, match=r"\.beltscape\.json: is no manifest"):
        put(tmp_path, "rig.json")


KILLED = """
import os, sys
from pathlib import Path
from beltscape.files import output_folder as module
from beltscape.files.atomic import write_text
out, moment = Path(sys.argv[1]), sys.argv[2]
replaced = []
replace = Path.replace
def counting(self, target):
    if moment == "swapping" and ".beltscape-partial" in self.parts and self.suffix == ".x":
        replaced.append(self)
        if len(replaced) == 2:
            os._exit(9)
    return replace(self, target)
Path.replace = counting
with module.owned_folder(out, "reconstruct") as staging:
    for name in ("1.x", "2.x", "3.x"):
        write_text(staging / name.replace(".x", ".y"), "new")
        os.rename(staging / name.replace(".x", ".y"), staging / name)
    if moment == "writing":
        os._exit(9)
"""


@pytest.mark.parametrize("moment", ["writing", "swapping"])
@pytest.mark.parametrize("earlier", [True, False])
def test_killed_run_is_never_read_as_a_result(tmp_path, moment, earlier):
    out = tmp_path / "out"
    if earlier:
        put(out, "1.x", "2.x", "old.x", text="old")
    done = subprocess.run([sys.executable, "-c", KILLED, str(out), moment], check=False)
    assert done.returncode == 9
    if moment == "writing" and earlier:
        require_finished(out)  # the earlier result is whole
        assert {text for name, text in read_files(out).items() if STAGING not in name} == {"old"}
    else:
        with pytest.raises(InputError, match="interrupted"):
            require_finished(out)
    put(out, "1.x", "2.x", "3.x", text="newest")
    require_finished(out)
    assert read_files(out) == dict.fromkeys(("1.x", "2.x", "3.x"), "newest")


def test_two_runs_do_not_write_one_folder(tmp_path):
    with owned_folder(tmp_path, "reconstruct") as staging:
        write_text(staging / "first", "")
        with pytest.raises(OutputError, match="another beltscape command is writing there"):
            put(tmp_path, "second")
    assert set(read_files(tmp_path)) == {"first"}


def test_a_link_to_a_folder_is_followed_and_a_broken_one_named(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to("real")
    put(tmp_path / "link", "rig.json")
    assert read_files(tmp_path / "real") == {"rig.json": "new"}
    (tmp_path / "broken").symlink_to("nowhere")
    with pytest.raises(OutputError, match="broken is a broken link"):
        put(tmp_path / "broken", "rig.json")


def test_continued_folder_is_reused_and_refused_to_other_commands(tmp_path):
    out = tmp_path / "out"
    for text in ("one", "two"):
        with continued_folder(out, "replay") as place, (place / "history").open("a") as file:
            file.write(text)
    assert read_files(out) == {"history": "onetwo"}
    with pytest.raises(OutputError, match="beltscape replay wrote"):
        put(out, "rig.json")
    with pytest.raises(ZeroDivisionError), continued_folder(tmp_path / "x" / "y", "replay"):
        raise ZeroDivisionError
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize(
    ("number", "message"),
    [
        (errno.ENOSPC, r"the disk is full \(\d+\.\d MiB free there\); free some space"),
        (errno.EDQUOT, "the disk is full"),
        (errno.EFBIG, "larger than this file system allows"),
        (errno.EROFS, "the file system is read-only"),
        (errno.EACCES, r"cannot be written \(Permission denied\)"),
    ],
)
def test_reason_of_a_failed_write_is_named(tmp_path, number, message):
    error = output_error(tmp_path / "not" / "there.tiff", OSError(number, os.strerror(number)))
    assert str(error).startswith(f"{tmp_path / 'not' / 'there.tiff'}: ")
    with pytest.raises(OutputError, match=message):
        raise error


def test_a_full_disk_while_the_files_move_is_one_line_and_marked(tmp_path, monkeypatch):
    put(tmp_path, "1", "2", text="old")
    replace = Path.replace

    def full(self, target):
        if self.name == "2" and STAGING in self.parts and Path(target).parent == tmp_path:
            raise OSError(errno.ENOSPC, "No space left on device", str(target))
        return replace(self, target)

    monkeypatch.setattr(module.Path, "replace", full)
    with pytest.raises(OutputError, match="2: the disk is full"):
        put(tmp_path, "1", "2")
    with pytest.raises(InputError, match="beltscape reconstruct was interrupted"):
        require_finished(tmp_path)
