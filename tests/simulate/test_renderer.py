from __future__ import annotations

import pytest

from beltscape.core.errors import SettingsError
from beltscape.simulate import renderer


@pytest.fixture
def llvm(monkeypatch):
    """A function that says which LLVM the machine has; no choice comes from the environment."""
    monkeypatch.delenv(renderer.ENVIRONMENT, raising=False)
    return lambda version: monkeypatch.setattr(renderer, "_llvm_version", lambda: version)


@pytest.mark.parametrize(("version", "engine"), [(-1, "scalar"), (15, "scalar"), (19, "llvm"), (21, "llvm")])
def test_llvm_is_taken_where_it_is_new_enough(llvm, version, engine):
    llvm(version)
    assert renderer.chosen() == engine


def test_the_environment_decides_what_was_left_open(llvm, monkeypatch):
    llvm(19)
    monkeypatch.setenv(renderer.ENVIRONMENT, "scalar")
    assert renderer.chosen() == "scalar"
    assert renderer.chosen("llvm") == "llvm"


def test_an_unknown_engine_in_the_environment_is_named(llvm, monkeypatch):
    llvm(19)
    monkeypatch.setenv(renderer.ENVIRONMENT, "cuda")
    with pytest.raises(SettingsError, match="BELTSCAPE_RENDERER = 'cuda'"):
        renderer.chosen()


def test_llvm_that_is_not_there_is_refused(llvm):
    llvm(-1)
    with pytest.raises(SettingsError, match="needs LLVM"):
        renderer.chosen("llvm")


def test_the_machines_own_llvm_is_asked_without_a_crash():
    assert renderer._llvm_version() >= -1
