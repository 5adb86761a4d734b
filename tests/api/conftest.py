"""What the tests of the door for Python share: a run directory, made once."""

from pathlib import Path

import pytest

from tests.cli.finished import made

WORDS = ("filter=[ekf,pf]", "runs=20", "keep_runs=3", "steps=25", "scenario.duration=2.5", "plots=true")


@pytest.fixture(scope="session")
def folder(tmp_path_factory) -> Path:
    """A finished run of two filters, with every picture."""
    return made(tmp_path_factory.mktemp("runs") / "one", *WORDS)
