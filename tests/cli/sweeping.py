"""What the tests of sweeps share: small sweeps, and their tables without what differs from one time to the next."""

import csv
import json
import time
from collections.abc import Callable
from pathlib import Path

from estlab.cli.main import main

TINY = ["scenario=landmark", "scenario.duration=0.5", "runs=2"]  # five steps: a run simulates no more


def sweep(*words: str, place: str = "swept") -> int:
    """A sweep of tiny jobs in a directory of this name, without plots."""
    return main(["sweep", *TINY, "plots=false", f"sweep.dir={place}", *words])


def rows(path: str) -> list[dict[str, str]]:
    with open(path, newline="") as stream:
        return list(csv.DictReader(stream))


def table(place: str = "swept") -> list[dict[str, str]]:
    """sweep.csv without wall times."""
    found = rows(f"{place}/sweep.csv")
    assert all(
        (float(row["wall_time_s"]) > 0.0) == (row["status"] in ("ok", "unmet")) for row in found if row["wall_time_s"]
    )
    return [{key: value for key, value in row.items() if key != "wall_time_s"} for row in found]


def status(folder: str | Path) -> dict:
    return json.loads((Path(folder) / "status.json").read_text())


def wait_for(condition: Callable[[], bool]) -> None:
    for _ in range(6000):
        if condition():
            return
        time.sleep(0.01)
    raise AssertionError("it never came true")


def job_folders(place: str = "swept") -> list[str]:
    return sorted(path.parent.name for path in Path(place).glob("*/status.json"))


def count(place: str, word: str) -> int:
    """How many jobs have this status at this moment."""
    return sum(f'"status": "{word}"' in path.read_text() for path in Path(place).glob("*/status.json"))
