"""Certificates: issued, verified in every form, and found altered, by another key, expired or outdated."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from beltscape.cli.main import main
from beltscape.core.errors import InputError, OutputError
from beltscape.core.progress import Silent
from beltscape.core.system_calls import lock_folder
from beltscape.files.json_text import to_plain
from beltscape.files.seal import open_key, read_sealed
from beltscape.pipeline.certifying import certificates
from beltscape.pipeline.certifying.certificates import (
    IssueOptions,
    find_in_force,
    issue_certificate,
    list_certificates,
    read_document,
    verify_certificate,
)
from beltscape.pipeline.certifying.material_test import EvaluatedTest, evaluate_test_file
from beltscape.report.production.pdf import lay_out
from beltscape.service.project import open_project
from tests.pipeline.certifying.plants import SimulatedPlant, make_tested_plant

NOW_MS = 1_795_000_000_000
"""2026-11-18."""
DAY_MS = 86_400_000


@pytest.fixture(scope="module")
def tested(tmp_path_factory) -> tuple[SimulatedPlant, EvaluatedTest]:
    plant, path = make_tested_plant(tmp_path_factory.mktemp("tested") / "plant")
    return plant, evaluate_test_file(path, open_project(plant.path), Silent())


@pytest.fixture
def data(tmp_path) -> Path:
    return tmp_path / "data"


def issue(data: Path, evaluated: EvaluatedTest, now_ms: int = NOW_MS, **values):
    return issue_certificate(data, evaluated, IssueOptions("belt 4", "meier", now_ms, **values))


def test_a_certificate_is_valid_in_every_form(data, tested) -> None:
    _, evaluated = tested
    pytest.importorskip("weasyprint")
    issued = issue(data, evaluated, pdf=True)
    key, present = open_key(data / "certificates").public_key, evaluated.document["applies"]
    for ending in (".json", ".html", ".pdf"):
        path = issued.path.with_suffix(ending)
        state = verify_certificate(path, NOW_MS + DAY_MS, trusted_key=key, present=present)
        assert state.verdict == "valid"
        assert state.statement == issued.statement
        assert state.days_left == pytest.approx(364)
        assert verify_certificate(path, NOW_MS).verdict == "intact"
    page = issued.page.read_text()
    assert issued.statement.number == "2026-0001"
    assert issued.fingerprint in page
    assert all(digest in page for digest in present.values())
    assert read_document(issued.path)["results"] == to_plain(evaluated.document["results"])


@pytest.mark.parametrize("language", ["en", "de", "es", "zh"])
def test_every_page_of_the_pdf_has_the_number_at_its_foot_and_text_that_can_be_selected(
    data, tested, language
) -> None:
    pytest.importorskip("weasyprint")
    if language == "zh" and not list_chinese_fonts():
        pytest.skip("no Chinese font is installed; `make system` brings one")
    issued = issue(data, tested[1], pdf=True, language=language)  # refused where no font has a letter
    pages = lay_out(issued.page.read_text()).pages
    assert len(pages) > 1
    for number, page in enumerate(pages, 1):
        texts = [box.text for box in page._page_box.descendants() if hasattr(box, "text")]
        assert f"{number} / {len(pages)}" in texts
        assert any(text.endswith(" 2026-0001") for text in texts)
        assert not [text for text in texts if text.endswith("\u2009")]  # a number does not end within


def list_chinese_fonts() -> str:
    return subprocess.run(["fc-list", ":lang=zh"], capture_output=True, text=True, check=True).stdout


def test_a_letter_that_no_font_has_is_named_and_nothing_is_issued(data, tested) -> None:
    pytest.importorskip("weasyprint")
    options = IssueOptions("belt \U0010fffd", "meier", NOW_MS, pdf=True)
    with pytest.raises(
        InputError, match=r"--pdf: no font of this machine has \U0010fffd; .*apt install fonts-"
    ):
        issue_certificate(data, tested[1], options)
    assert list_certificates(data) == [] and not list((data / "certificates").glob("*.pdf"))


def test_what_ends_a_certificate_is_named(data, tested) -> None:
    _, evaluated = tested
    path, key = issue(data, evaluated).path, open_key(data / "certificates").public_key
    present = dict(evaluated.document["applies"])
    changed = {**present, "rig": "f" * 64, "program": "9.9"}
    later = NOW_MS + 400 * DAY_MS
    states = {
        "expired": verify_certificate(path, later, trusted_key=key, present=present),
        "no longer applies": verify_certificate(path, NOW_MS, trusted_key=key, present=changed),
        "other key": verify_certificate(path, NOW_MS, trusted_key=b"x" * 32, present=present),
        "not yet valid": verify_certificate(path, NOW_MS - 3 * DAY_MS, trusted_key=key, present=present),
    }
    assert {name: state.verdict for name, state in states.items()} == {name: name for name in states}
    assert states["no longer applies"].changed == ("rig", "program")
    document = json.loads(path.read_text())
    document["document"]["results"][0]["value"] *= 1.01
    path.write_text(json.dumps(document))
    assert verify_certificate(path, NOW_MS, trusted_key=key, present=present).verdict == "altered"


def test_a_page_whose_figures_were_changed_is_altered(data, tested) -> None:
    page = issue(data, tested[1]).page
    text = page.read_text()
    assert "limestone" in text
    page.write_text(text.replace("limestone", "sandstone", 1))
    assert verify_certificate(page, NOW_MS).verdict == "altered"


def test_numbers_go_on_and_nothing_issued_is_written_again(data, tested) -> None:
    first = issue(data, tested[1])
    before = {path: path.read_bytes() for path in first.path.parent.iterdir()}
    second = issue(data, tested[1], NOW_MS + DAY_MS, valid_days=30)
    next_year = issue(data, tested[1], NOW_MS + 100 * DAY_MS, valid_days=30)
    assert [one.statement.number for one in (first, second, next_year)] == [
        "2026-0001",
        "2026-0002",
        "2027-0001",
    ]
    assert {path: path.read_bytes() for path in before} == before
    in_force = find_in_force(data)
    assert in_force is not None
    assert in_force.statement == next_year.statement
    (data / "certificates/2027-0002.json").write_text("damaged")
    assert len(list_certificates(data)) == 3
    assert issue(data, tested[1], NOW_MS + 101 * DAY_MS).statement.number == "2027-0003"


class Killed(BaseException):
    """Stands for a kill, which no handler sees."""


@pytest.mark.parametrize("names_written", [0, 1, 2])
def test_a_program_that_is_killed_draws_no_second_number(data, tested, monkeypatch, names_written) -> None:
    written, commit = [], certificates.commit_file

    def commit_some(part: Path, path: Path) -> None:
        if len(written) == names_written:
            raise Killed
        written.append(path.name)
        commit(part, path)

    open_key(data / "certificates")
    monkeypatch.setattr(certificates, "commit_file", commit_some)
    if names_written < 2:
        with pytest.raises(Killed):
            issue(data, tested[1])
    else:
        issue(data, tested[1])
    assert written == ["2026-0001.json", "2026-0001.html"][:names_written]
    monkeypatch.setattr(certificates, "commit_file", commit)
    again = issue(data, tested[1], NOW_MS + DAY_MS)
    assert (again.statement.number, again.is_new) == ("2026-0001", not written)
    assert again.statement.issued_ms == (NOW_MS if written else NOW_MS + DAY_MS)
    names = sorted(path.name for path in (data / "certificates").iterdir())
    assert names == ["2026-0001.html", "2026-0001.json", "key.pem", "key.pub"]
    assert verify_certificate(again.page, NOW_MS + DAY_MS).verdict == "intact"
    assert read_sealed(again.page).statement == again.statement.to_plain()


def test_one_program_at_a_time_draws_a_number(data, tested) -> None:
    issue(data, tested[1])
    handle = lock_folder(data / "certificates")
    with pytest.raises(InputError, match="another program issues a certificate"):
        issue(data, tested[1], valid_days=30)
    os.close(handle)
    assert issue(data, tested[1], valid_days=30).statement.number == "2026-0002"


def test_a_page_that_is_there_is_not_overwritten(data, tested, monkeypatch) -> None:
    issue(data, tested[1])
    monkeypatch.setattr(certificates, "_find_number", lambda *_: "2026-0001")
    with pytest.raises(OutputError, match="never written again"):
        issue(data, tested[1], valid_days=30)


def test_the_commands_issue_list_and_verify(tmp_path, tested, capsys) -> None:
    plant, _ = tested
    folder = tmp_path / "plant"
    shutil.copytree(plant.folder, folder)
    project, out = str(folder / "project.toml"), str(tmp_path / "out")
    words = ["certify", "material", str(folder / "material_test.toml"), "--project", project, "--out", out]
    assert main([*words, "--issue", "--by", "meier", "--language", "de", "--json"]) == 0
    certificate = json.loads(capsys.readouterr().out)["certificate"]
    assert certificate["issued_by"] == "meier"
    assert main([*words, "--issue", "--by", "meier", "--language", "de"]) == 0
    assert (
        f"certificate {certificate['number']}, which certifies this test already" in capsys.readouterr().out
    )
    page = Path(certificate["page"]).read_text()
    assert "Datensätze 301 bis 460" in page
    assert "0,05 % + 1 kg" in page
    assert main(["certify", "verify", certificate["page"], "--project", project, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["verdict"] == "valid"
    assert main(["certify", "verify", certificate["page"]]) == 0
    assert "who signed it is not checked" in capsys.readouterr().out
    assert main(["certify", "list", project]) == 0
    assert re.search(r"^\d{4}-0001  in force  365 days left", capsys.readouterr().out)
    audit = (folder / "data/audit.jsonl").read_text()
    assert audit.count('"certificate issued"') == audit.count('"certificate asked for again"') == 1
    (folder / "belt.json").write_text('{"belt": 2}')
    assert main(["certify", "verify", certificate["file"], "--project", project]) == 2
    assert "no longer applies; changed since: empty; repeat" in capsys.readouterr().err
    assert main(["certify", "list", project]) == 0
    listed = capsys.readouterr().out
    assert re.search(r"^\d{4}-0001  ended  .*changed since: empty", listed), "what has ended is not in force"
    (folder / "data/certificates/key.pub").rename(tmp_path / "plant.pub")
    assert main(["certify", "verify", certificate["file"], "--project", project]) == 2
    assert "key.pub: is lost; restore it from a backup" in capsys.readouterr().err
    assert main([*words, "--valid-days", "0"]) == 2
    assert "--valid-days 0: must be above 0" in capsys.readouterr().err
    assert main([*words, "--language", "xx"]) == 2
    assert "--language = 'xx': there are de, en, es, zh" in capsys.readouterr().err
    (tmp_path / "key.pub").write_text("A" * 43 + "=\n")
    assert main(["certify", "verify", certificate["file"], "--key", str(tmp_path / "key.pub")]) == 2
    assert "signed by another key" in capsys.readouterr().err


def test_without_the_library_nothing_is_signed_and_the_line_says_what_to_install(
    tested, data, monkeypatch
) -> None:
    import builtins

    real = builtins.__import__

    def refuse(name, *args, **kwargs):
        if name.startswith("cryptography"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(InputError, match=r"pip install 'beltscape\[certificates\]'"):
        issue(data, tested[1])
    assert not data.exists()
