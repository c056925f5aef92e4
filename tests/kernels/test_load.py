"""The choice of a back end and of an instruction-set level."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import beltscape
from beltscape.core.errors import KernelError
from beltscape.kernels import load, load_on_processor
from beltscape.kernels.native import levels


@pytest.fixture(autouse=True)
def fresh(monkeypatch):
    monkeypatch.delenv("BELTSCAPE_KERNELS", raising=False)
    load.cache_clear()
    yield
    load.cache_clear()


def test_native_is_the_best_level_of_this_processor():
    assert load().name == load("native").name == levels()[-1]


def test_the_environment_chooses_where_the_caller_does_not(monkeypatch):
    monkeypatch.setenv("BELTSCAPE_KERNELS", "reference")
    assert load().name == "reference"
    assert load("native").name == levels()[-1]


@pytest.mark.parametrize("name", [None, "cuda", "emulated-1", "reference", levels()[0]])
def test_kernels_of_the_processor_open_no_gpu(monkeypatch, name):
    monkeypatch.setattr("beltscape.kernels._kernels_on", lambda _: pytest.fail("a GPU is opened"))
    monkeypatch.setattr("beltscape.kernels._find_gpu_kernels", lambda _: pytest.fail("a GPU is looked for"))
    if name:
        monkeypatch.setenv("BELTSCAPE_KERNELS", name)
    expected = name if name in ("reference", levels()[0]) else levels()[-1]
    assert load_on_processor().name == expected


def test_only_the_matcher_and_the_check_of_an_installation_may_open_a_gpu():
    """A process that measures takes none of the memory that those which match need."""
    package = Path(beltscape.__file__).parent
    imports = re.compile(r"from beltscape\.kernels import (\([^)]*\)|[^\n]*)|kernels\.(load)\(")
    found = {
        str(path.relative_to(package))
        for path in package.rglob("*.py")
        if any(re.search(r"\bload\b", "".join(names)) for names in imports.findall(path.read_text()))
    }
    assert found == {"pipeline/installation.py", "stereo/multiview/reconstructor.py"}


def test_an_unknown_name_lists_the_known_ones():
    with pytest.raises(KernelError) as error:
        load("v9")
    assert str(error.value) == (
        f"no kernels named 'v9' on this processor; there are reference, native, {', '.join(levels())}, cuda"
    )


def test_missing_native_modules_say_how_to_build_them(monkeypatch):
    monkeypatch.setattr("beltscape.kernels.native.find_spec", lambda _: None)
    levels.cache_clear()
    try:
        with pytest.raises(KernelError) as error:
            load("native")
    finally:
        levels.cache_clear()
    assert str(error.value) == "the native kernels are not built; run: make install"


def test_a_level_the_processor_lacks_is_not_offered(monkeypatch):
    from beltscape.kernels import native

    real = native._module

    class Old:
        def __init__(self, module):
            self.triangulate = module.triangulate

        def cpu_level(self):
            return "v2"

    monkeypatch.setattr(native, "_module", lambda level: Old(real(level)))
    levels.cache_clear()
    try:
        assert "v3" not in levels()
        assert "v4" not in levels()
    finally:
        levels.cache_clear()
