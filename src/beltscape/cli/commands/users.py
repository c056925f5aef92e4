"""``beltscape users list|add|remove|passwd|role|key|unkey PROJECT [NAME]``: manages users and keys.

It works with or without the service running.
"""

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
    """Declare the sub-commands and their arguments."""
    commands = parser.add_subparsers(dest="what", required=True, metavar="WHAT")
    _command(commands, "list", "all users")
    add = _command(commands, "add", "add a user; asks for the password", named=True)
    add.add_argument("--role", choices=ROLES, required=True, help="what the user may do")
    _command(commands, "remove", "remove a user with all sessions", named=True)
    passwd = _command(commands, "passwd", "set a user's password; asks for it, ends all sessions", named=True)
    role = _command(commands, "role", "change a user's role", named=True)
    role.add_argument("role", choices=ROLES, help="what the user may do")
    _command(commands, "key", "create a key by which a program may read; it is printed only once", named=True)
    _command(commands, "unkey", "remove a program's key", named=True)
    for command in (add, passwd):
        command.add_argument(
            "--password-stdin", action="store_true", help="read the password from standard input"
        )


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Run the sub-command."""
    from beltscape.files.atomic import ensure_output_folder
    from beltscape.service.access import Access
    from beltscape.service.data_rights import restrict_rights

    folder = _data_folder(arguments.place)
    if not folder.is_dir() and arguments.what not in ("add", "key"):
        raise InputError(
            f"{folder}: no such folder; the first `beltscape users add` or `beltscape run` creates it"
        )
    with restrict_rights(folder):
        if not folder.is_dir():
            ensure_output_folder(folder)
        with closing(Access(folder)) as access:
            key = _COMMANDS[arguments.what](access, arguments)
            users = [{"name": u.name, "role": u.role, "sessions": u.sessions} for u in access.accounts.list()]
            keys = [one.name for one in access.keys.list()]
    return {"users": users, "keys": keys, "data": folder} | ({"key": key} if key else {})


def summary(result: Mapping[str, Any]) -> str:
    """Return the new key, or else all users and keys."""
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
    """Return the data folder, given itself or a project.toml, of which only ``data`` is read."""
    if place.is_dir():
        return place
    from beltscape.files.toml_text import read_toml

    data = read_toml(place).get("data", "data")
    if not isinstance(data, str):
        raise InputError(f"{place}: data = {data!r}: must be the name of a folder")
    return place.parent / data


def _add(access: Access, arguments: argparse.Namespace) -> None:
    user = access.accounts.add(arguments.name, arguments.role, _password(arguments))
    _audit(access, "user added", {"user": user.name, "role": user.role})


def _remove(access: Access, arguments: argparse.Namespace) -> None:
    access.accounts.remove(arguments.name)
    _audit(access, "user removed", {"user": arguments.name})


def _passwd(access: Access, arguments: argparse.Namespace) -> None:
    access.accounts.set_password(arguments.name, _password(arguments))
    _audit(access, "password changed", {"user": arguments.name})


def _role(access: Access, arguments: argparse.Namespace) -> None:
    access.accounts.set_role(arguments.name, arguments.role)
    _audit(access, "role changed", {"user": arguments.name, "role": arguments.role})


def _key(access: Access, arguments: argparse.Namespace) -> str:
    key = access.keys.create(arguments.name)
    _audit(access, "key made", {"key": arguments.name})
    return key


def _unkey(access: Access, arguments: argparse.Namespace) -> None:
    access.keys.remove(arguments.name)
    _audit(access, "key removed", {"key": arguments.name})


def _audit(access: Access, action: str, detail: Mapping[str, str]) -> None:
    import getpass

    access.audit.write(action, f"{getpass.getuser()} on this machine", "beltscape users", detail)


def _password(arguments: argparse.Namespace) -> str:
    if arguments.password_stdin:
        try:
            return sys.stdin.readline().rstrip("\r\n")
        except UnicodeDecodeError as error:
            raise InputError(
                f"password: standard input is not {error.encoding}; send it in this encoding"
            ) from error
    from getpass import getpass

    if not sys.stdin.isatty():
        raise InputError(
            "password: standard input is no terminal; give --password-stdin and pipe the password in"
        )
    password = getpass("password: ")
    if getpass("repeat: ") != password:
        raise InputError("password: the two entries differ; try again")
    return password


def _list(access: Access, arguments: argparse.Namespace) -> None:
    """Change nothing; every command returns the users."""


_COMMANDS = {
    "list": _list,
    "add": _add,
    "remove": _remove,
    "passwd": _passwd,
    "role": _role,
    "key": _key,
    "unkey": _unkey,
}
