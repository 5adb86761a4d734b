"""Run directories for tests that read them."""

import contextlib
import io
import json
from pathlib import Path

from estlab.cli.main import main

TINY = ("scenario=landmark", "steps=25", "runs=12", "keep_runs=3", "plots=false")


def made(folder: Path, *words: str) -> Path:
    """A run in this directory, quietly."""
    with contextlib.redirect_stdout(io.StringIO()):
        assert main(["run", *TINY, *words, f"hydra.run.dir={folder}", f"output={folder.parent}"]) == 0
    return folder


def edit(file: Path, **changes: object) -> None:
    """Change keys of a JSON file."""
    file.write_text(json.dumps(json.loads(file.read_text()) | changes))
