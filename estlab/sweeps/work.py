"""Runs jobs, whole or in parts, in the directory of a sweep that no other process is using."""

import errno
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from estlab.config.groups import SweepSettings
from estlab.errors import UserError
from estlab.launch.launcher import FAILED
from estlab.rundir import files
from estlab.rundir.layout import STOP
from estlab.sweeps import split, state
from estlab.sweeps.rounds import Rounds
from estlab.sweeps.state import Outcome, Planned

if TYPE_CHECKING:
    from hydra.types import HydraContext
    from omegaconf import DictConfig


# Submitit's jobs leave pickles there, and it loads any file with such a name: the folder must be this sweep's own.
_SUBMITIT = ".submitit"


class Work:
    """The jobs that run in a sweep's directory, and their outcomes."""

    def __init__(self, context: "HydraContext", config: "DictConfig", sweep: Path, limits: SweepSettings) -> None:
        state.set_aside(sweep, _SUBMITIT, whatever=True)
        self.sweep, self.rounds = sweep, Rounds(context, config, sweep, limits)

    def outcomes(self, jobs: Sequence[Planned]) -> dict[str, Outcome]:
        """For each job and part: the outcome in its directory, or why it has none."""
        lost = {name: Outcome("failed", message, FAILED) for name, message in self.rounds.errors.items()}
        return {name: lost.get(name, found) for name, found in split.outcomes(jobs, self.sweep).items()}

    def claim(self, units: Sequence[Planned]) -> None:
        """Check that these jobs and parts can run.

        Raises UserError if a worker of an earlier sweep is still running one.
        """
        for unit in units:
            if process := state.at_work(self.sweep, unit.name):
                raise UserError(
                    f"{self.sweep / unit.name}: process {process} of an earlier sweep is still at work on it; wait "
                    "for it or end it, then resume"
                )

    def run(self, units: Sequence[Planned]) -> None:
        """Run these jobs and parts, then merge the jobs whose parts are all ok.

        Raises UserError if the launcher itself cannot start.
        """
        for unit in units:
            state.set_aside(self.sweep, unit.name)
        self.rounds.run(_whole(units))
        self.rounds.run(split.merges([unit for unit in units if unit.parts > 1], self.sweep))

    def workers(self, units: Sequence[Planned]) -> AbstractContextManager[None]:
        """In the body, whose first thread is the process's second, these are run on all cores."""
        return self.rounds.workers(_whole(units))

    @property
    def stopped(self) -> bool:
        """Whether a job failed and no other may start (sweep.fail_fast)."""
        return state.stopped(self.sweep)

    @contextmanager
    def unstopped(self) -> Iterator[None]:
        """Clear the stop before the body and after it."""
        files.remove(self.sweep, STOP)
        try:
            yield
        finally:
            files.remove(self.sweep, STOP)


def _whole(units: Sequence[Planned]) -> list[Planned]:
    """Those that are not to be put together from parts."""
    return [unit for unit in units if unit.parts == 1]


@contextmanager
def opened(sweep: Path) -> Iterator[None]:
    """A sweep's directory, created if needed, for this process alone.

    Raises UserError if another process has it, or if it cannot be written.
    """
    try:
        sweep.mkdir(parents=True, exist_ok=True)
        with state.locked(sweep):
            yield
    except files.RefusedError as error:
        raise UserError(
            f"{error.filename}: {error.strerror}; remove it, or give this sweep another sweep.dir"
        ) from error
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        remedy = "free some space, or set output to another disk" if full else "give this sweep another sweep.dir"
        raise UserError(f"{error.filename or sweep}: {error.strerror}; {remedy}") from error
