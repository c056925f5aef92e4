"""The choice of a back end and of an instruction-set level."""

from __future__ import annotations

import pytest

from beltscape.core.errors import KernelError
from beltscape.kernels import load
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
