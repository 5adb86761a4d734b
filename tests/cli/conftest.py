"""What all tests of commands share."""

import pytest


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path, monkeypatch):
    """Whatever a command leaves is not left in the checkout."""
    monkeypatch.chdir(tmp_path)
