"""The trials of a tuning: their table, their picture, and what is printed of the best."""

import math
import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import accumulate
from pathlib import Path
from typing import Literal

from estlab import rundir
from estlab.config.settings import NEITHER, words_without
from estlab.launch.arguments import OF_A_SWEEP
from estlab.launch.path_arguments import as_typed
from estlab.metrics.objective import Objective
from estlab.report import csv_tables, grids
from estlab.report.console import print_line
from estlab.report.grids import Grid
from estlab.rundir import files
from estlab.rundir.layout import TUNING
from estlab.sweeps.dimensions import Dimension, Numbers
from estlab.sweeps.state import Outcome, Planned

_LISTED = 5  # the best trials
_END = 0.02  # of an interval, near which a value is at its end


@dataclass(frozen=True)
class Trial:
    """A job and what it was worth; error: why it has no objective."""

    job: Planned
    state: Literal["ok", "unmet", "failed", "no objective", "left"] = "left"
    objective: float | None = None
    error: str = ""


def concluded(job: Planned, found: Outcome, objective: Objective, lost: float) -> Trial:
    """A trial whose job has ended. lost: the share of runs that may break."""
    if found.state == "unmet":
        return Trial(job, "unmet", error=found.error)
    if found.state != "ok":
        return Trial(job, "failed" if found.state in ("failed", "damaged") else "left", error=found.error)
    try:
        return Trial(job, "ok", objective.of(found.rows, lost))
    except ValueError as error:
        return Trial(job, "no objective", error=str(error))


def ranked(trials: Sequence[Trial]) -> list[Trial]:
    """Those with a finite objective, the best first, of equals the earlier."""
    known = [trial for trial in trials if trial.objective is not None and math.isfinite(trial.objective)]
    return sorted(known, key=lambda trial: (trial.objective, trial.job.number))


def write(sweep: Path, trials: Sequence[Trial]) -> None:
    """Write tuning.csv: trial, job, values, objective, best so far, state, error."""
    keys = list(dict.fromkeys(key for trial in trials for key in trial.job.values))
    best = list(accumulate((math.inf if trial.objective is None else trial.objective for trial in trials), min))
    columns = {
        "trial": [trial.job.number for trial in trials],
        "job": [trial.job.name for trial in trials],
        **{key: [trial.job.values[key] for trial in trials] for key in keys},
        "objective": [trial.objective for trial in trials],
        "best": [one if one < math.inf else None for one in best],
        "state": [trial.state for trial in trials],
        "error": [trial.error for trial in trials],
    }
    files.write(sweep, TUNING, partial(csv_tables.write, columns))


def draw(sweep: Path, trials: Sequence[Trial], objective: Objective) -> list[str]:
    """Draw plots/tuning.png from tuning.csv; what could not be drawn."""
    from estlab.report import tuning_plots
    from estlab.report.figures import png

    if not ranked(trials):
        return []
    try:
        content = png(tuning_plots.draw(sweep / TUNING, list(trials[0].job.values), objective.words))
    except Warning:
        raise
    except Exception as error:
        return [f"missing: tuning.png ({type(error).__name__}: {error})"]
    files.write(sweep, f"{rundir.PLOTS}/tuning.png", lambda stream: stream.write(content))
    return []


def edges(trials: Sequence[Trial], dimensions: Mapping[str, Dimension]) -> list[str]:
    """Where the best value is at an end of what could be chosen from."""
    notes = []
    for best in ranked(trials)[:1]:
        for key, among in dimensions.items():
            if isinstance(among, Numbers) and among.step is None:
                value = best.job.values[key.lstrip("+")]
                low, high, at = (math.log(x) if among.log else x for x in (among.low, among.high, float(value)))
                if min(at - low, high - at) < _END * (high - low):
                    notes.append(
                        f"{key}={value} is at the end of its interval; a wider interval may contain a better value"
                    )
    return notes


def summary(sweep: Path, trials: Sequence[Trial], objective: Objective, wanted: int, notes: Sequence[str]) -> None:
    """The best trials, the best as a command that can be typed, and where it all is."""
    best = ranked(trials)
    headings = ("trial", *(trials[0].job.values if trials else ()), objective.words)
    lines = [[str(one.job.number), *one.job.values.values(), f"{one.objective:.5g}"] for one in best[:_LISTED]]
    grids.show(Grid("", headings, lines, left=0))
    for trial in trials:
        if trial.state == "no objective":
            print_line(f"no objective: {trial.job.name}: {trial.error}")
    for note in notes:
        print_line(f"note: {note}")
    counts = Counter([*(trial.state for trial in trials), *["left"] * (wanted - len(trials))])
    words = ("ok", "unmet", "failed", "no objective", "left")
    print_line(", ".join(f"{counts[word]} {word}" for word in words if counts[word]))
    if best:
        print_line(f"best: {command(best[0])}")
        print_line(str(sweep / best[0].job.name))
    print_line(str(sweep))


def command(trial: Trial) -> str:
    """The trial as a run of its own."""
    words = [as_typed(word) for word in words_without(trial.job.overrides, NEITHER) if word not in OF_A_SWEEP]
    return shlex.join(["estlab", "run", *words])
