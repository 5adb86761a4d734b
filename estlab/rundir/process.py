"""Identifies the process at work: not its zombie, another with its number, or one from before a reboot."""

import os
import platform
import subprocess
from collections.abc import Mapping
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

Life = Literal["alive", "gone", "unknown"]

_PROC = Path("/proc")
_SLACK = 5.0  # seconds of tolerance, in case a clock is set meanwhile


class _Seen(NamedTuple):
    """A process that exists. began: its start, in the system's own form; zombie: dead, but not yet reaped."""

    began: int | str
    zombie: bool


def marks() -> dict[str, Any]:
    """The identity of this process, as a status stores it: number, machine, boot, namespace, start."""
    seen = _seen(os.getpid())
    return {
        "pid": os.getpid(),
        "node": platform.node(),
        "boot": _boot(),
        "namespace": _namespace(),
        "process_began": seen.began if seen else None,
    }


def life(marks: Mapping[str, Any]) -> Life:
    """Whether the process with this identity is alive; unknown if that cannot be seen from here.

    The identity from an earlier estlab, only number and machine, stands for a Python process that existed before the
    run began.
    """
    pid = marks.get("pid")
    if not isinstance(pid, int) or isinstance(pid, bool) or not 0 < pid < 2**31 or marks.get("node") != platform.node():
        return "unknown"
    if _differ(marks.get("boot"), _boot()):
        return "gone"
    if _differ(marks.get("namespace"), _namespace()):
        return "unknown"  # its numbers belong to another namespace
    seen = _seen(pid)
    if seen is None:
        return _by_signal(pid)
    if seen.zombie or _differ(marks.get("process_began"), seen.began):
        return "gone"
    if marks.get("process_began") is None and not _may_be_of_an_earlier_estlab(pid, seen, marks.get("began")):
        return "gone"
    return "alive"


def _differ(one: object, other: object) -> bool:
    """Whether two values are known and differ."""
    return one is not None and other is not None and one != other


def _seen(pid: int) -> _Seen | None:
    """A process as the system shows it; None if it does not."""
    if not (_PROC / "self/stat").exists():
        return _seen_by_ps(pid)
    try:
        # The name, in brackets, may contain anything.
        words = (_PROC / str(pid) / "stat").read_bytes().rpartition(b")")[2].split()
        return _Seen(int(words[19]), words[0] in (b"Z", b"X"))
    except (OSError, ValueError, IndexError):
        return None


def _seen_by_ps(pid: int) -> _Seen | None:
    """The same on systems without /proc."""
    try:
        status = subprocess.run(
            ["ps", "-o", "stat=,lstart=", "-p", str(pid)],
            capture_output=True, text=True, timeout=10, check=True, env={**os.environ, "LC_ALL": "C", "TZ": "UTC"},
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return None
    state, _, began = status.stdout.strip().partition(" ")
    return _Seen(" ".join(began.split()), state.startswith("Z")) if began else None


def _by_signal(pid: int) -> Life:
    try:
        os.kill(pid, 0)  # it sends no signal, it only checks
    except ProcessLookupError:
        return "gone"
    except OSError:
        return "unknown"  # belongs to another user
    return "alive"


def _may_be_of_an_earlier_estlab(pid: int, seen: _Seen, began: object) -> bool:
    if isinstance(seen.began, str):
        return True
    try:
        booted = next(int(line.split()[1]) for line in (_PROC / "stat").read_text().splitlines() if "btime" in line)
        since = booted + seen.began / os.sysconf("SC_CLK_TCK")
        if since > datetime.fromisoformat(str(began)).timestamp() + _SLACK:
            return False
        return "python" in (_PROC / str(pid) / "exe").readlink().name
    except (OSError, ValueError, StopIteration, OverflowError):
        return True


@cache
def _boot() -> str | None:
    """The number of this boot of the system."""
    try:
        return (_PROC / "sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        return None  # without it, a process's start is a date


@cache
def _namespace() -> str | None:
    """The namespace of process numbers; a container has its own."""
    try:
        return str((_PROC / "self/ns/pid").readlink())
    except OSError:
        return None
