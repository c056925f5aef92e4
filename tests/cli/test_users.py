"""``beltscape users`` as a command, with and without the service running."""

from __future__ import annotations

import io
import json

import pytest

from beltscape.cli import main as program
from beltscape.service.access import Access
from beltscape.service.access import accounts as accounts_module
from beltscape.service.access.passwords import ScryptCost

PASSWORD = "coal on the belt"


@pytest.fixture(autouse=True)
def desk(tmp_path, monkeypatch):
    """A project with a data folder; cheap passwords."""
    monkeypatch.setattr(accounts_module, "ScryptCost", lambda: ScryptCost(4, 8, 1))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "project.toml").write_text('data = "kept"\n')
    (tmp_path / "kept").mkdir()
    return tmp_path


def users(monkeypatch, *words: str, said: str = "") -> int:
    monkeypatch.setattr("sys.stdin", io.StringIO(said))
    return program.main(["users", *words])


def test_users_are_added_and_removed(monkeypatch, capsys):
    add = ("add", "project.toml", "Anna", "--role=engineer", "--password-stdin")
    assert users(monkeypatch, *add, said=PASSWORD + "\n") == 0
    assert users(monkeypatch, "add", "kept", "bert", "--role=viewer", "--password-stdin", said=PASSWORD) == 0
    assert users(monkeypatch, "role", "kept", "bert", "operator") == 0
    capsys.readouterr()
    assert users(monkeypatch, "list", "project.toml", "--json") == 0
    listed = json.loads(capsys.readouterr().out)["users"]
    assert [(u["name"], u["role"]) for u in listed] == [("anna", "engineer"), ("bert", "operator")]
    assert users(monkeypatch, "remove", "kept", "bert") == 0
    assert capsys.readouterr().out.split() == ["anna", "engineer", "0", "sessions"]


def test_the_service_sees_it_at_once(monkeypatch, desk):
    access = Access(desk / "kept")
    assert access.setup_token
    users(monkeypatch, "add", "kept", "anna", "--role=engineer", "--password-stdin", said=PASSWORD)
    assert access.setup_token is None
    token = access.log_in("anna", PASSWORD, "")
    assert access.identify(token)
    assert users(monkeypatch, "passwd", "kept", "anna", "--password-stdin", said="ore on the belt") == 0
    assert access.identify(token) is None
    assert access.log_in("anna", "ore on the belt", "")
    access.close()


def test_what_is_done_is_in_the_audit_log_without_the_password(monkeypatch, desk):
    users(monkeypatch, "add", "kept", "anna", "--role=engineer", "--password-stdin", said=PASSWORD)
    entry = json.loads((desk / "kept" / "audit.jsonl").read_text())
    assert (entry["what"], entry["user"], entry["from"]) == ("user added", "anna", "beltscape users")
    assert entry["who"].endswith("on this machine")
    assert PASSWORD not in str(entry)


@pytest.mark.parametrize(
    ("words", "said", "line"),
    [
        (["list", "gone"], "", "beltscape: gone: no such file"),
        (
            ["add", "kept", "a b", "--role=viewer", "--password-stdin"],
            PASSWORD,
            "beltscape: user 'a b': a name has 1 to",
        ),
        (
            ["add", "kept", "anna", "--role=viewer", "--password-stdin"],
            "short",
            "beltscape: password: must have 10 to",
        ),
        (
            ["add", "kept", "anna", "--role=viewer"],
            "",
            "beltscape: password: standard input is no terminal; give",
        ),
        (["remove", "kept", "anna"], "", "beltscape: user 'anna': there is none; see the list of users"),
        (["role", "kept", "anna", "boss"], "", "beltscape users role: argument role: invalid choice: 'boss'"),
    ],
)
def test_what_is_wrong_is_one_line(monkeypatch, capsys, words, said, line):
    try:
        code = users(monkeypatch, *words, said=said)
    except SystemExit as left:
        code = left.code
    assert code == 2
    message = capsys.readouterr().err
    assert message.startswith(line)
    assert message.count("\n") == 1


def test_a_data_folder_that_is_not_there(monkeypatch, capsys, desk):
    (desk / "project.toml").write_text("")
    assert users(monkeypatch, "list", "project.toml") == 2
    line = "beltscape: data: no such folder; the first `beltscape users add` or `beltscape run` creates it\n"
    assert capsys.readouterr().err == line
    assert not (desk / "data").exists()
    (desk / "project.toml").write_text("data = 3")
    assert users(monkeypatch, "list", "project.toml") == 2
    assert capsys.readouterr().err.startswith(
        "beltscape: project.toml: data = 3: must be the name of a folder"
    )


@pytest.mark.parametrize("data", ["", 'data = "plant/kept here"'])
def test_the_first_user_may_be_added_before_the_first_run(monkeypatch, desk, data):
    (desk / "project.toml").write_text(data)
    folder = desk / (data[8:-1] or "data")
    add = ("add", "project.toml", "bela", "--role=engineer", "--password-stdin")
    assert users(monkeypatch, *add, said=PASSWORD + "\n") == 0
    assert [path.stat().st_mode & 0o027 for path in (folder, folder / "users.db")] == [0, 0]
    access = Access(folder)
    assert access.setup_token is None
    assert access.log_in("bela", PASSWORD, "")
    access.close()


def test_a_password_in_another_encoding_is_refused(monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO("Grüße".encode("latin-1")), "utf-8"))
    assert program.main(["users", "add", "kept", "anna", "--role=viewer", "--password-stdin"]) == 2
    assert (
        capsys.readouterr().err
        == "beltscape: password: standard input is not utf-8; send it in this encoding\n"
    )


def test_a_password_typed_twice(monkeypatch, desk):
    class Screen(io.StringIO):
        def isatty(self) -> bool:
            return True

    answers = iter([PASSWORD, "something else", PASSWORD, PASSWORD])
    monkeypatch.setattr("getpass.getpass", lambda _: next(answers))
    monkeypatch.setattr("sys.stdin", Screen())
    words = ["users", "add", "kept", "anna", "--role=engineer"]
    assert program.main(words) == 2
    assert program.main(words) == 0


def test_a_programs_key_is_shown_once(monkeypatch, capsys, desk):
    assert users(monkeypatch, "key", "kept", "prometheus") == 0
    key = capsys.readouterr().out.splitlines()[0]
    access = Access(desk / "kept")
    assert access.keys.find(key)
    assert users(monkeypatch, "list", "kept") == 0
    assert capsys.readouterr().out.split() == ["prometheus", "key"]
    assert users(monkeypatch, "unkey", "kept", "prometheus") == 0
    assert access.keys.find(key) is None
    assert [entry["what"] for entry in access.audit.read_last(2)] == ["key removed", "key made"]
    access.close()
    assert users(monkeypatch, "unkey", "kept", "prometheus") == 2
