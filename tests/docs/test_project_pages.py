"""Files, packages and modules that the project pages name exist; the commands of CONTRIBUTING.md work."""

from __future__ import annotations

import builtins
import re

import pytest

from tests.docs.blocks import read_spans
from tests.docs.conftest import page_text
from tests.docs.reader import Reader
from tests.docs.results import Results
from tests.docs.system import ROOT

PACKAGES = ROOT / "src/beltscape"
PAGES = sorted(str(path.relative_to(ROOT)) for path in (ROOT / "docs").rglob("*.md"))
TEXTS = {".md", ".py", ".toml", ".yaml", ".yml", ".sh"}
MATCHER = PACKAGES / "stereo/multiview"
_ROW = re.compile(r"^\| `(\w+)` \|(.*)\|$", re.M)
_STEP = re.compile(r"^\d\. .*$", re.M)


def has_module(folder, name: str) -> bool:
    return (folder / f"{name}.py").is_file() or (folder / name).is_dir()


def missing_paths(page: str) -> list[str]:
    """Return the code spans of a page that look like paths in the repository and match no file or folder."""
    paths = [span for _, span in read_spans(page_text(page)) if re.fullmatch(r"[\w./*]+", span)]
    tops = tuple(f"{path.name}/" for path in ROOT.iterdir() if path.is_dir())
    return [path for path in paths if path.startswith(tops) and not [*ROOT.glob(path.rstrip("/"))]]


def read_make_targets() -> set[str]:
    """Return the targets of the Makefile."""
    return set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.M))


def read_texts() -> dict[str, str]:
    """Return pages, settings and code of the project by their paths, without what is built or installed."""
    folders = ("benchmarks", "deploy", "docs", "examples", "src", "tests", "tools", ".github")
    paths = [path for folder in folders for path in (ROOT / folder).rglob("*") if path.suffix in TEXTS]
    paths += [path for path in ROOT.iterdir() if path.suffix in TEXTS or path.name == "Makefile"]
    return {str(path.relative_to(ROOT)): path.read_text(errors="ignore") for path in paths}


def test_make_targets_named_anywhere_exist():
    targets = read_make_targets()
    named = {
        (path, target)
        for path, text in read_texts().items()
        for target in re.findall(r"`make ([a-z]+)", text)
    }
    assert len({target for _, target in named}) > 5
    assert sorted(one for one in named if one[1] not in targets) == []


def test_pages_of_the_manual_named_anywhere_exist():
    named = {
        (path, page)
        for path, text in read_texts().items()
        for page in re.findall(r"\bdocs/[\w/]+\.(?:md|ipynb)\b", text)
    }
    assert len({page for _, page in named}) > 10
    assert sorted(one for one in named if not (ROOT / one[1]).is_file()) == []


def test_the_checks_of_a_change_call_targets_that_exist():
    called = re.findall(r"^ *make (?:-\S+ )*([a-z]+)", (ROOT / ".ci/run").read_text(), re.M)
    assert called
    assert [target for target in called if target not in read_make_targets()] == []


def test_constants_of_the_table_exist():
    folder, missing, rows = PACKAGES, [], 0
    for line in page_text("docs/reference/constants.md").splitlines():
        if line.startswith("## "):
            folder = PACKAGES / line[3:].replace(".", "/")
        elif row := re.match(r"\| `([\w.]+)\.(\w+)` \|", line):
            rows += 1
            module = folder / f"{row[1].replace('.', '/')}.py"
            if not module.is_file() or not re.search(rf"^(\w+, )*{row[2]}\b.* = ", module.read_text(), re.M):
                missing.append(f"{module.relative_to(PACKAGES)}: {row[2]}")
    assert rows > 50
    assert missing == []


def test_commands_of_the_contributing_page_hold(tmp_path):
    reader = Reader(tmp_path, Results(tmp_path / "results"))
    reader.follow("CONTRIBUTING.md", page_text("CONTRIBUTING.md"))
    assert reader.wrong == []


def test_names_of_the_guides_to_additions_are_defined():
    guides = page_text("CONTRIBUTING.md").split("## How to add …")[1].split("\n## ")[0]
    names = set(re.findall(r"`([A-Z]\w+|\w+_\w+)`", guides)) - {"NamedTuple"}
    code = "\n".join(path.read_text("utf-8") for path in PACKAGES.rglob("*.py"))
    defined = set(re.findall(r"^(?:class |def |    def )?(\w+)\b(?=[(:\[ ])", code, re.M))
    assert len(names) > 20
    assert sorted(names - defined - {path.stem for path in PACKAGES.rglob("*.py")}) == []


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "ARCHITECTURE.md"])
def test_named_files_exist(page):
    assert missing_paths(page) == []


@pytest.mark.parametrize("page", PAGES)
def test_modules_named_in_the_manual_exist(page):
    spans = [span for _, span in read_spans(page_text(page))]
    modules = [span for span in spans if re.fullmatch(r"[\w/]+\.(py|hpp|cpp)", span)]
    folders = ("src", "native", "tools", "tests", "benchmarks", "examples", "deploy")
    present = [str(path) for folder in folders for path in (ROOT / folder).rglob("*.*")]
    assert [module for module in modules if not any(one.endswith(f"/{module}") for one in present)] == []


@pytest.mark.parametrize("page", ["explanation/measuring.md", "python.md"])
def test_functions_called_in_the_manual_exist(page):
    spans = [span for _, span in read_spans(page_text(f"docs/{page}"))]
    names = {name for span in spans for name in re.findall(r"(\w+)\(", span)}
    code = "\n".join(path.read_text() for path in PACKAGES.rglob("*.py"))
    assert names
    own = sorted(name for name in names if not hasattr(builtins, name))
    assert [name for name in own if not re.search(rf"^ *(def|class) {name}\b", code, re.M)] == []


def test_the_start_page_leads_to_every_page():
    linked = set(re.findall(r"\]\(([\w/]+\.md)\)", page_text("docs/index.md")))
    pages = {page.removeprefix("docs/") for page in PAGES} - {"index.md"}
    assert sorted(page for page in pages - linked if not page.startswith("decisions/0")) == []


def test_every_decision_is_listed():
    listed = re.findall(r"\]\((\d{4}-[\w-]+\.md)\)", page_text("docs/decisions/index.md"))
    assert listed == sorted(path.name for path in (ROOT / "docs/decisions").glob("0*.md"))


def test_packages_are_complete_and_their_parts_exist():
    rows = dict(_ROW.findall(page_text("ARCHITECTURE.md")))
    packages = {path.parent.name for path in PACKAGES.glob("*/__init__.py")}
    assert set(rows) == packages
    for package, text in rows.items():
        assert len(text.split()) <= 25, package
        for part in re.findall(r"`(\w+)/?`", text):
            children = [PACKAGES / package, *(PACKAGES / package).iterdir()]
            assert any(has_module(folder, part) for folder in children) or part in packages, (package, part)


def test_steps_through_the_matcher_name_its_modules():
    steps = _STEP.findall(page_text("ARCHITECTURE.md"))
    assert len(steps) == 8
    for step in steps:
        for name in re.findall(r"`([\w/]+)`", step):
            parts = [MATCHER, *(path for path in MATCHER.iterdir() if path.is_dir())]
            assert any(has_module(folder, name) for folder in parts), name


def test_classes_of_the_glossary_exist():
    names = {
        span
        for _, span in read_spans(page_text("docs/reference/glossary.md"))
        if re.fullmatch(r"([A-Z][a-z]+)+", span)
    }
    code = "\n".join(path.read_text() for path in PACKAGES.rglob("*.py"))
    assert len(names) > 10
    assert [name for name in sorted(names) if not re.search(rf"^class {name}\b", code, re.M)] == []
