"""A job in parts: its blocks of runs as separate jobs, and the step that merges them into the job's own directory."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from estlab.sweeps import state
from estlab.sweeps.state import Outcome, Planned

PARTS = "parts"  # the folder that contains a folder for each job


def parts_of(job: Planned) -> list[Planned]:
    """The parts of a job; empty for one that runs whole."""
    if job.parts == 1:
        return []
    width = len(str(job.parts - 1))
    return [
        Planned(
            number=job.number,
            # With another number of parts on resuming, these are other parts.
            name=f"{PARTS}/{job.name}/{which:0{width}}-of-{job.parts}",
            overrides=(*job.overrides, f"part=[{which},{job.parts}]"),
            values=job.values,
            fingerprint=state.of_part(job.fingerprint, which, job.parts),
            composed=job.composed,
            own={"part": [which, job.parts]},
        )
        for which in range(job.parts)
    ]


def units(jobs: Sequence[Planned]) -> list[Planned]:
    """Everything that runs: each job's parts, then the job."""
    return [unit for job in jobs for unit in (*parts_of(job), job)]


def outcomes(jobs: Sequence[Planned], sweep: Path) -> dict[str, Outcome]:
    """The outcome in the directory of each job and part. A job that is ok no longer needs its parts."""
    found: dict[str, Outcome] = {}
    for job in jobs:
        own = state.outcome(sweep, job.name, job.fingerprint)
        for part in parts_of(job):
            done = own.whole
            found[part.name] = Outcome("ok") if done else state.outcome(sweep, part.name, part.fingerprint)
        found[job.name] = own
    return found


def whole(job: Planned, outcomes: Mapping[str, Outcome]) -> Outcome:
    """The outcome of a job: one that never got to merging failed if a part did."""
    own = outcomes[job.name]
    if own.state == "left":
        for part in parts_of(job):
            found = outcomes[part.name]
            if found.state in ("failed", "damaged"):
                return Outcome("failed", f"{part.name}: {found.error}", found.code)
    return own


def merges(jobs: Sequence[Planned], sweep: Path) -> list[Planned]:
    """The jobs whose parts are all ok, with the places of their parts."""
    found = outcomes(jobs, sweep)
    ready = [job for job in jobs if all(found[part.name].whole for part in parts_of(job))]
    return [_merge(job, sweep) for job in ready]


def _merge(job: Planned, sweep: Path) -> Planned:
    return replace(job, own={"parts": [str(sweep / part.name) for part in parts_of(job)]})
