"""The choice of Mitsuba's engine."""

from __future__ import annotations

import pytest

from beltscape.core.errors import SettingsError
from beltscape.simulate.rendering import render as renderer
from beltscape.simulate.rendering.render import RenderSettings


@pytest.fixture
def llvm(monkeypatch):
    """A function that sets the LLVM version which the machine seems to have."""
    return lambda version: monkeypatch.setattr(renderer, "_llvm_version", lambda: version)


@pytest.mark.parametrize(("version", "engine"), [(-1, "scalar"), (15, "scalar"), (19, "llvm"), (21, "llvm")])
def test_auto_uses_llvm_where_it_is_recent_enough(llvm, version, engine):
    llvm(version)
    assert renderer.resolve_engine("auto") == engine


def test_default_engine_does_not_depend_on_the_machine(llvm):
    llvm(21)
    assert renderer.resolve_engine(RenderSettings().engine) == "scalar"


@pytest.mark.parametrize("version", [-1, 15])
def test_llvm_that_is_missing_or_too_old_is_refused(llvm, version):
    llvm(version)
    with pytest.raises(SettingsError, match=r"needs LLVM.*version 19"):
        renderer.resolve_engine("llvm")


def test_version_is_read_without_a_crash_on_any_machine():
    assert renderer._llvm_version() >= -1
