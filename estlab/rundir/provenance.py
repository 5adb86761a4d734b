"""Where figures come from: versions, commit, machine, and the hashes of the files that were read."""

import hashlib
import os
import platform
import resource
import subprocess
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

from estlab import __version__

_PACKAGES = ("numpy", "scipy", "hydra-core", "omegaconf", "pandas", "matplotlib", "rich")


@cache
def origin() -> dict[str, Any]:
    """What ran, and on what."""
    return {
        "estlab": __version__,
        "python": platform.python_version(),
        "packages": {name: _version(name) for name in _PACKAGES},
        "git": _git_state(Path(__file__).parents[2]),
        "machine": {"node": platform.node(), "system": platform.platform(), "cores": os.cpu_count()},
    }


def hashes(files: Iterable[Path]) -> list[dict[str, str]]:
    """Each file with its SHA-256."""
    return [{"file": str(path.resolve()), "sha256": digest(path)} for path in files]


def digest(path: Path) -> str:
    """The SHA-256 of a file."""
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def peak_memory() -> int:
    """The peak memory of this process, in bytes. The kernel counts in kB, macOS in bytes."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def _version(package: str) -> str | None:
    from importlib import metadata  # a fifth of what estlab --help takes, which needs no versions

    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _git_state(checkout: Path) -> dict[str, object] | None:
    """The commit, and whether the tree differs from it, if estlab runs from a checkout; otherwise None."""
    if not (checkout / ".git").exists():
        return None
    try:
        ask = ["git", "-C", str(checkout)]
        commit = subprocess.run([*ask, "rev-parse", "HEAD"], capture_output=True, text=True, timeout=10, check=True)
        changes = subprocess.run(
            [*ask, "status", "--porcelain"], capture_output=True, text=True, timeout=10, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return {"commit": commit.stdout.strip(), "dirty": bool(changes.stdout.strip())}
