"""``beltscape users list|add|remove|passwd|role|key|unkey PROJECT [NAME]``: works whether or not the service runs."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beltscape.core.errors import InputError
from beltscape.core.progress import Reporter

if TYPE_CHECKING:
    from beltscape.service.access import Access

ROLES = ("viewer", "operator", "engineer")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what can be done, and the arguments."""
    commands = parser.add_subparsers(dest="what", required=True, metavar="WHAT")
    _command(commands, "list", "all users")
    add = _command(commands, "add", "a further user; asks for the password", named=True)
    add.add_argument("--role", choices=ROLES, required=True, help="what the user may do")
    _command(commands, "remove", "take a user away, with all sessions", named=True)
    passwd = _command(
        commands, "passwd", "set a user's password anew; asks for it, ends all sessions", named=True
    )
    role = _command(commands, "role", "give a user another role", named=True)
    role.add_argument("role", choices=ROLES, help="what the user may do")
    _command(commands, "key", "a new key by which a program may read; printed this once", named=True)
    _command(commands, "unkey", "take a program's key away", named=True)
    for command in (add, passwd):
        command.add_argument(
            "--password-stdin", action="store_true", help="read the password from standard input"
        )


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Do it."""
    from beltscape.service.access import Access

    folder = _data_folder(arguments.place)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; it is made by the first `beltscape run`, or make it")
    with closing(Access(folder)) as access:
        made = _DO[arguments.what](access, arguments)
        users = [{"name": u.name, "role": u.role, "sessions": u.sessions} for u in access.accounts.list()]
        keys = [key.name for key in access.keys.list()]
    return {"users": users, "keys": keys, "data": folder} | ({"key": made} if made else {})


def summary(result: Mapping[str, Any]) -> str:
    """A key that was made; else all users and keys, as they are now."""
    if "key" in result:
        return f"{result['key']}\nsend it as `Authorization: Bearer KEY`; it is not shown again"
    if not result["users"] and not result["keys"]:
        return f"{result['data']}: no users yet; `beltscape users add` or the page's setup creates the first engineer"
    users = [f"{u['name']:<32} {u['role']:<9} {u['sessions']} sessions" for u in result["users"]]
    return "\n".join([*users, *(f"{name:<32} key" for name in result["keys"])])


def _command(commands: Any, name: str, text: str, *, named: bool = False) -> argparse.ArgumentParser:
    parser = commands.add_parser(name, help=text, description=text)
    parser.add_argument("place", type=Path, metavar="PROJECT", help="project.toml, or its data folder")
    if named:
        parser.add_argument("name", metavar="NAME")
    return parser


def _data_folder(place: Path) -> Path:
    """The data folder itself, or what a project.toml says: nothing else of it needs to be in order."""
    if place.is_dir():
        return place
    from beltscape.files.documents.toml_text import read_toml

    data = read_toml(place).get("data", "data")
    if not isinstance(data, str):
        raise InputError(f"{place}: data = {data!r}: must be the name of a folder")
    return place.parent / data


def _add(access: Access, arguments: argparse.Namespace) -> None:
    user = access.accounts.add(arguments.name, arguments.role, _password(arguments))
    _note(access, "user added", {"user": user.name, "role": user.role})


def _remove(access: Access, arguments: argparse.Namespace) -> None:
    access.accounts.remove(arguments.name)
    _note(access, "user removed", {"user": arguments.name})


def _passwd(access: Access, arguments: argparse.Namespace) -> None:
    access.accounts.set_password(arguments.name, _password(arguments))
    _note(access, "password changed", {"user": arguments.name})


def _role(access: Access, arguments: argparse.Namespace) -> None:
    access.accounts.set_role(arguments.name, arguments.role)
    _note(access, "role changed", {"user": arguments.name, "role": arguments.role})


def _key(access: Access, arguments: argparse.Namespace) -> str:
    key = access.keys.create(arguments.name)
    _note(access, "key made", {"key": arguments.name})
    return key


def _unkey(access: Access, arguments: argparse.Namespace) -> None:
    access.keys.remove(arguments.name)
    _note(access, "key removed", {"key": arguments.name})


def _note(access: Access, what: str, detail: Mapping[str, str]) -> None:
    import getpass

    access.audit.write(what, f"{getpass.getuser()} on this machine", "beltscape users", detail)


def _password(arguments: argparse.Namespace) -> str:
    if arguments.password_stdin:
        return sys.stdin.readline().rstrip("\r\n")
    from getpass import getpass

    if not sys.stdin.isatty():
        raise InputError(
            "password: standard input is no terminal; give --password-stdin and pipe the password in"
        )
    password = getpass("password: ")
    if getpass("once more: ") != password:
        raise InputError("password: the two are not the same; try again")
    return password


_DO = {
    "list": lambda _access, _arguments: None,
    "add": _add,
    "remove": _remove,
    "passwd": _passwd,
    "role": _role,
    "key": _key,
    "unkey": _unkey,
}
