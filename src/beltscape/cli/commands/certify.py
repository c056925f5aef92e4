"""``beltscape certify material|object|verify|list``: material tests, and the certificates that follow from them."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beltscape.cli.arguments import add_output_folder
from beltscape.core.errors import InputError, SettingsError
from beltscape.core.progress import Reporter

if TYPE_CHECKING:
    from beltscape.pipeline.certifying.material_test import EvaluatedTest
    from beltscape.pipeline.live.project import Project
    from beltscape.service.project import ProjectSettings

_LONGEST_DAYS = 3650
"""Largest validity: ten years."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-commands and their arguments."""
    commands = parser.add_subparsers(dest="form", required=True, metavar="WHAT")
    material = _command(commands, "material", "evaluate a material test; with --issue certify it")
    material.add_argument(
        "test", type=Path, metavar="TEST", help="TOML file of the test: runs, references, zero"
    )
    _add_evaluation(material)
    thing = _command(commands, "object", "the quick form: an object of known volume, measured in passing")
    thing.add_argument(
        "flows", type=Path, nargs="+", metavar="FLOW", help="folders of measure flow, one a pass"
    )
    form = thing.add_mutually_exclusive_group(required=True)
    form.add_argument("--box", type=float, nargs=3, metavar=("L", "W", "H"), help="its edges, mm")
    form.add_argument("--module", type=Path, help="its module.toml")
    thing.add_argument(
        "--sigma", type=float, required=True, metavar="MM", help="one standard deviation of an edge"
    )
    _add_evaluation(thing)
    verify = _command(
        commands, "verify", "whether a certificate is as it was signed, by whom, and still applies"
    )
    verify.add_argument("certificate", type=Path, metavar="FILE", help="certificate as .json, .html or .pdf")
    verify.add_argument(
        "--project", type=Path, help="project.toml of the plant: its key, and what it measures by"
    )
    verify.add_argument(
        "--key", type=Path, metavar="FILE", help="the plant's key.pub, where there is no project"
    )
    listing = _command(commands, "list", "the certificates of a plant, the newest first")
    listing.add_argument("project", type=Path, help="project.toml of the plant")


def _command(commands: Any, name: str, text: str) -> argparse.ArgumentParser:
    return commands.add_parser(name, help=text, description=text)


def _add_evaluation(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--project", type=Path, required=True, help="project.toml of the plant")
    parser.add_argument(
        "--issue", action="store_true", help="sign it with the plant's key and put it in force"
    )
    parser.add_argument(
        "--valid-days",
        type=float,
        default=365.0,
        metavar="D",
        help="validity of the certificate (default: 365)",
    )
    parser.add_argument(
        "--by", default="", metavar="NAME", help="who issues it (default: the user of this machine)"
    )
    parser.add_argument("--language", default="en", help="of the page: en, de, es or zh (default: en)")
    parser.add_argument("--pdf", action="store_true", help="also write a PDF; needs beltscape[reports]")
    add_output_folder(parser, "folder for test.json and report.html", required=True)


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Run the sub-command."""
    return {"form": arguments.form, **_RUNS[arguments.form](arguments, reporter)}


def _run_material(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    from beltscape.pipeline.certifying.material_test import evaluate_test_file
    from beltscape.service.project import open_project

    _check_options(arguments)
    project = open_project(arguments.project)
    return _write(arguments, project, evaluate_test_file(arguments.test, project, reporter))


def _run_object(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    from beltscape.pipeline.certifying.known_volume import make_box, make_module, make_object_settings
    from beltscape.pipeline.certifying.material_test import evaluate_test
    from beltscape.service.project import open_project

    _check_options(arguments)
    if not 0 < arguments.sigma <= 10:
        raise SettingsError(f"--sigma {arguments.sigma:g}: must be above 0 and at most 10 mm")
    if arguments.box is not None and not all(1 <= edge <= 10_000 for edge in arguments.box):
        raise SettingsError(f"--box {' '.join(f'{e:g}' for e in arguments.box)}: edges are 1 to 10,000 mm")
    known = (
        make_module(arguments.module, arguments.sigma)
        if arguments.box is None
        else make_box(arguments.box, arguments.sigma)
    )
    project = open_project(arguments.project)
    settings = make_object_settings(known, arguments.flows, _name_user(arguments))
    return _write(arguments, project, evaluate_test(settings, arguments.project, project, reporter))


def _check_options(arguments: argparse.Namespace) -> None:
    """Raise before a long evaluation what a wrong option would end."""
    from beltscape.files.seal import require_signatures
    from beltscape.report.metrology.certificate import open_metrology_texts
    from beltscape.report.production.pdf import require_pdf

    if not 0 < arguments.valid_days <= _LONGEST_DAYS:
        raise SettingsError(
            f"--valid-days {arguments.valid_days:g}: must be above 0 and at most {_LONGEST_DAYS}"
        )
    open_metrology_texts(arguments.language, "UTC")
    if arguments.pdf:
        require_pdf("--pdf")
    if arguments.issue:
        require_signatures()


def _name_user(arguments: argparse.Namespace) -> str:
    import getpass

    return arguments.by or getpass.getuser()


def _write(
    arguments: argparse.Namespace, project: Project[ProjectSettings], evaluated: EvaluatedTest
) -> Mapping[str, Any]:
    """Write the evaluation into the folder, and issue the certificate where that is wanted."""
    from beltscape.files.atomic import ensure_output_folder, write_text
    from beltscape.files.json_text import write_json
    from beltscape.report.metrology.certificate import render_certificate

    ensure_output_folder(arguments.out)
    zone = project.settings.production.time_zone
    page = render_certificate(evaluated.document, evaluated.pictures, arguments.language, zone)
    files = {"report": arguments.out / "report.html", "test": arguments.out / "test.json"}
    write_text(files["report"], page)
    write_json(files["test"], evaluated.document)
    issued = _issue(arguments, project, evaluated, zone) if arguments.issue else None
    return {**evaluated.document, "files": files, "certificate": issued}


def _issue(
    arguments: argparse.Namespace, project: Project[ProjectSettings], evaluated: EvaluatedTest, zone: str
) -> Mapping[str, Any]:
    from contextlib import closing
    from time import time_ns

    from beltscape.pipeline.certifying.certificates import IssueOptions, issue_certificate
    from beltscape.service.access import Access
    from beltscape.service.data_rights import restrict_rights

    data, by = project.resolve(project.settings.data), _name_user(arguments)
    options = IssueOptions(
        plant=project.settings.name,
        by=by,
        now_ms=time_ns() // 1_000_000,
        valid_days=arguments.valid_days,
        language=arguments.language,
        zone=zone,
        pdf=arguments.pdf,
    )
    with restrict_rights(data):
        issued = issue_certificate(data, evaluated, options)
        with closing(Access(data)) as access:
            detail = {"number": issued.statement.number, "key": issued.fingerprint}
            action = "certificate issued" if issued.is_new else "certificate asked for again"
            access.audit.write(action, f"{by} on this machine", "beltscape certify", detail)
    return {
        **issued.statement.to_plain(),
        "key": issued.fingerprint,
        "file": issued.path,
        "page": issued.page,
        "is_new": issued.is_new,
    }


def _run_verify(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    from time import time_ns

    from beltscape.files.seal import read_public_key
    from beltscape.pipeline.certifying.certificates import read_plant_key, verify_certificate
    from beltscape.pipeline.live.measuring_parts import describe_provenance
    from beltscape.service.project import open_project

    key = None if arguments.key is None else read_public_key(arguments.key)
    present = None
    if arguments.project is not None:
        project = open_project(arguments.project)
        key = read_plant_key(project.resolve(project.settings.data)) if key is None else key
        present = describe_provenance(project)
    state = verify_certificate(
        arguments.certificate, time_ns() // 1_000_000, trusted_key=key, present=present
    )
    if state.verdict not in ("valid", "intact"):
        raise InputError(f"{arguments.certificate}: {_explain(state.verdict, state)}")
    return {
        "verdict": state.verdict,
        **state.statement.to_plain(),
        "key": state.fingerprint,
        "days_left": state.days_left,
        "changed": list(state.changed),
        "compared_with_plant": present is not None,
    }


def _explain(verdict: str, state: Any) -> str:
    """Return why a certificate does not hold, and what to do, in one line."""
    number, plant, key = state.statement.number, state.statement.plant, state.fingerprint
    changed = f"; changed since: {', '.join(state.changed)}" if state.changed else ""
    texts = {
        "altered": "altered: it is not as it was signed; get the certificate again from the plant that issued it",
        "other key": f"signed by another key ({key}) than the plant's; ask who issued it",
        "not yet valid": f"certificate {number} of {plant} begins later; check this machine's clock",
        "expired": f"certificate {number} of {plant} expired {-state.days_left:.0f} days ago{changed}; repeat the "
        "material test",
        "no longer applies": f"certificate {number} of {plant} no longer applies{changed}; repeat the material test, "
        "or restore what changed",
    }
    return texts[verdict]


def _run_list(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    from time import time_ns

    from beltscape.pipeline.certifying.certificates import list_certificates
    from beltscape.pipeline.live.measuring_parts import describe_provenance
    from beltscape.service.project import open_project

    project, now_ms = open_project(arguments.project), time_ns() // 1_000_000
    data, present = project.resolve(project.settings.data), describe_provenance(project)
    return {
        "certificates": [
            {
                **one.statement.to_plain(),
                "key": one.fingerprint,
                "file": one.path,
                "days_left": one.statement.days_left(now_ms),
                "changed": list(one.statement.list_changed(present)),
                "is_newest": number == 0,
                "in_force": number == 0 and one.statement.is_in_force(now_ms, present),
            }
            for number, one in enumerate(list_certificates(data))
        ],
        "data": data,
    }


_RUNS = {"material": _run_material, "object": _run_object, "verify": _run_verify, "list": _run_list}


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    if result["form"] == "list":
        rows = [_describe_row(one) for one in result["certificates"]]
        return "\n".join(
            rows or [f"{result['data']}: no certificate yet; beltscape certify material … --issue"]
        )
    if result["form"] == "verify":
        return _summarise_state(result)
    from beltscape.report.metrology.certificate import format_result, open_metrology_texts, summarise_test

    texts = open_metrology_texts("en", "UTC")
    lines = [summarise_test(result, texts)]
    lines += [f"{texts('result.' + one['key'])}: {format_result(one, texts)}" for one in result["results"]]
    lines += [f"note: {texts(f'note.{key}')}" for key in result["notes"]]
    lines += [f"{name:<6} {path}" for name, path in result["files"].items()]
    issued = result["certificate"]
    if issued is not None:
        again = "" if issued["is_new"] else ", which certifies this test already"
        lines.append(f"certificate {issued['number']}{again}, key {issued['key']}: {issued['page']}")
    return "\n".join(lines)


def _describe_row(one: Mapping[str, Any]) -> str:
    days, changed = one["days_left"], ", ".join(one["changed"])
    state = f"{days:.0f} days left" if days >= 0 else f"expired {-days:.0f} days ago"
    state += f"; changed since: {changed}" if changed else ""
    standing = "in force" if one["in_force"] else "ended   " if one["is_newest"] else "earlier "
    return f"{one['number']}  {standing}  {state}  {one['file']}"


def _summarise_state(result: Mapping[str, Any]) -> str:
    lines = [
        f"{result['verdict']}: certificate {result['number']} of {result['plant']}, issued by {result['issued_by']}, "
        f"{result['days_left']:.0f} days left",
        f"key {result['key']}",
    ]
    if result["verdict"] == "intact":
        lines.append(
            "who signed it is not checked: give --project or --key, or compare the key with the plant's"
        )
    if not result["compared_with_plant"]:
        lines.append("whether it still applies is not checked: give --project")
    return "\n".join(lines)
