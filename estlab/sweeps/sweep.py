"""One sweep from its words to its tables: plan, run what is not ok, tell what came of it."""

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, cast

from estlab import rundir
from estlab.config import sweep_settings
from estlab.errors import UserError
from estlab.launch import FAILED, INTERRUPTED, OK, USAGE, complain
from estlab.sweeps import jobs, split, state, table, told
from estlab.sweeps.progress import watched
from estlab.sweeps.rounds import Rounds
from estlab.sweeps.state import Outcome, Planned

if TYPE_CHECKING:
    from hydra.types import HydraContext
    from omegaconf import DictConfig

SOME_FAILED = 3


class Sweep:
    """The jobs of a sweep, in one directory, by whatever launcher the configuration names."""

    def __init__(self, context: "HydraContext", config: "DictConfig") -> None:
        from omegaconf import OmegaConf

        self.context, self.config = context, config
        self.limits = sweep_settings(cast(dict[str, object], OmegaConf.to_container(config.sweep, resolve=True)))
        self.directory = Path(str(config.hydra.sweep.dir)).resolve()  # for workers that stand elsewhere
        self.errors: dict[str, str] = {}

    def run(self, words: Sequence[str]) -> int:
        """Run the sweep that these words describe; its exit code.

        Raises UserError if nothing can start.
        """
        planned = jobs.planned(self.context, self.config, words, self.limits)
        told.fewer_parts(planned, self.limits.split_runs)
        if self.limits.dry_run:
            told.plan(planned, self._outcomes(planned))
            return OK
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            with state.locked(self.directory):
                state.begin(self.directory, sys.argv[1:], planned)
                return self._run(planned)
        except OSError as error:
            raise UserError(
                f"{error.filename or self.directory}: {error.strerror}; make room or set output to another disk"
            ) from error

    def _run(self, planned: list[Planned]) -> int:
        rundir.link_latest(self.directory, Path(str(self.config.output)))
        interrupted = False
        try:
            self._run_what_is_left(planned)
        except KeyboardInterrupt:
            interrupted = True
        outcomes = self._outcomes(planned)
        code = INTERRUPTED if interrupted else _exit_code(split.whole(job, outcomes) for job in planned)
        try:
            table.write_all(self.directory, planned, outcomes, self.limits.repeats)
            notes = self._plots(planned, outcomes)
        except OSError as error:
            notes = [f"{error.filename}: {error.strerror}; make room and resume, to write what is missing"]
            code = max(code, FAILED)
        told.summary(self.directory, planned, outcomes, self.limits.repeats, notes)
        if interrupted:
            complain(f"interrupted; estlab sweep --resume {self.directory} goes on")
        return code

    def _run_what_is_left(self, planned: list[Planned]) -> None:
        before = self._outcomes(planned)
        left = [unit for unit in split.units(planned) if before[unit.name].state != "ok"]
        for unit in left:
            if process := state.at_work(self.directory / unit.name):
                raise UserError(
                    f"{self.directory / unit.name}: process {process}, of an earlier sweep, is still at work on it; "
                    "wait for it or end it, then resume"
                )
        told.resumed(self.directory, planned, before)
        for unit in left:
            state.set_aside(self.directory, unit.name)
        (self.directory / state.STOP).unlink(missing_ok=True)
        rounds = Rounds(self.context, self.config, self.directory, self.limits)
        self.errors = rounds.errors
        try:
            with watched(self.directory, [unit.name for unit in left], len(before) - len(left)):
                rounds.run([unit for unit in left if unit.parts == 1])
                rounds.run(split.merges([job for job in left if job.parts > 1], self.directory))
        finally:
            (self.directory / state.STOP).unlink(missing_ok=True)

    def _plots(self, planned: list[Planned], outcomes: dict[str, Outcome]) -> list[str]:
        if not self.config.plots:
            return []
        return table.draw_all(self.directory, planned, outcomes, self.limits.repeats, self.limits.zip)

    def _outcomes(self, planned: Sequence[Planned]) -> dict[str, Outcome]:
        found = split.outcomes(planned, self.directory)
        return found | {name: Outcome("failed", message, FAILED) for name, message in self.errors.items()}


def _exit_code(outcomes: Iterable[Outcome]) -> int:
    found = list(outcomes)
    ok = sum(outcome.state == "ok" for outcome in found)
    if ok:
        return OK if ok == len(found) else SOME_FAILED
    return USAGE if all(outcome.code == USAGE for outcome in found) else FAILED
