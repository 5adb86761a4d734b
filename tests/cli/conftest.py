"""What all tests of commands share."""

import pytest

from estlab.sweeps import forked


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path, monkeypatch):
    """Whatever a command leaves is not left in the checkout."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture(autouse=True)
def _jobs_in_this_process(monkeypatch):
    """Sweeps run their jobs here, where tests see and change what they do; workers have tests of their own."""
    monkeypatch.setattr(forked, "can_fork", lambda: False)
