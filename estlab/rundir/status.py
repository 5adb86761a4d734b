"""How a run ended, or which process is at work on it: status.json."""

import json
import re
import time
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any, Literal, get_args

from estlab.rundir import files, process
from estlab.rundir.layout import RECORD_BYTES, STATUS

# unmet: complete, but an expectation was not met.
State = Literal["running", "ok", "unmet", "failed", "interrupted"]
STATES: tuple[State, ...] = get_args(State)
WHOLE = ("ok", "unmet")  # with every figure

# The status is padded to this size, so that "failed" fits in place of "running" even on a full disk.
_BYTES = 2048


def stamp(state: State, began: float, message: str = "", code: int = 0) -> bytes:
    """The status of a run of this process in written form. began: seconds since 1970."""
    facts: dict[str, Any] = {"status": state, "began": iso(began), **process.marks()}
    if state != "running":
        facts |= {"ended": iso(time.time()), "error": message[:1000], "exit_code": code}
    return (json.dumps(facts, indent=2) + "\n").encode().ljust(_BYTES)


def replace(root: Path, name: str, content: bytes) -> None:
    """Write a status whole, or in place if there is no room for a new file. Raises OSError if neither works."""
    try:
        files.write(root, name, lambda stream: stream.write(content))
    except OSError:
        with files.in_place(root, name) as stream:
            stream.write(content)


def end(root: Path, folder: str, message: str) -> None:
    """Set "failed" in the directory of a run whose process is gone; creates the directory if the process never did."""
    name = f"{folder}/{STATUS}"
    try:
        began = datetime.fromisoformat(json.loads(files.read(root, name, RECORD_BYTES))["began"]).timestamp()
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        began = time.time()
    replace(root, name, stamp("failed", began, message, 1))


def iso(seconds: float) -> str:
    """Local time with its offset."""
    return datetime.fromtimestamp(seconds).astimezone().isoformat()


def state_of(status: Mapping[str, Any]) -> str:
    """The state in a status. A run that only missed expectations, which was once called failed, is unmet."""
    state = str(status.get("status"))
    missed = re.match(r"\d+ of \d+ expectations? not met: ", str(status.get("error")))
    return "unmet" if state == "failed" and missed else state


def worker(status: Mapping[str, Any]) -> process.Life:
    """Whether a process is at work on a run, by its status; never for one that has ended."""
    return process.life(status) if status.get("status") == "running" else "gone"
