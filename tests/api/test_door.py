"""The door itself: it opens at once, and offers what it says."""

import subprocess
import sys

import pytest

import estlab

HEAVY = {"numpy", "hydra", "omegaconf", "pandas", "matplotlib", "scipy", "rich", "yaml"}


def test_importing_estlab_imports_nothing_heavy():
    code = f"import sys, estlab; print({HEAVY!r} & {{name.partition('.')[0] for name in sys.modules}})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


@pytest.mark.parametrize("name", estlab.__all__)
def test_every_name_that_is_listed_is_there(name):
    assert getattr(estlab, name) is getattr(estlab, name)
    assert name in dir(estlab)


def test_a_name_that_is_not_listed_is_none_of_the_doors():
    with pytest.raises(AttributeError, match="has no attribute 'ruin'"):
        _ = estlab.ruin  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", [name for name in estlab.__all__ if callable(getattr(estlab, name))])
def test_every_name_of_the_door_says_what_it_is(name):
    assert len(getattr(estlab, name).__doc__) > 40
