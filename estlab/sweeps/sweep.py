"""A sweep from its words to its tables: plans, runs what is not ok, and reports the result."""

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, cast

from estlab import rundir
from estlab.config.build import sweep_settings
from estlab.launch.execute import write_page
from estlab.launch.launcher import FAILED, INTERRUPTED, OK, USAGE, complain, pasted
from estlab.sweeps import announcements, jobs, split, state, table
from estlab.sweeps.progress import watched
from estlab.sweeps.state import Outcome, Planned
from estlab.sweeps.work import Work, opened

if TYPE_CHECKING:
    from hydra.types import HydraContext
    from omegaconf import DictConfig

SOME_FAILED = 3


class SweepRunner:
    """The jobs of a sweep, in one directory, by the launcher that the configuration names."""

    def __init__(self, context: "HydraContext", config: "DictConfig") -> None:
        from omegaconf import OmegaConf

        self.context, self.config = context, config
        self.limits = sweep_settings(cast(dict[str, object], OmegaConf.to_container(config.sweep, resolve=True)))
        self.directory = Path(str(config.hydra.sweep.dir)).resolve()  # for workers in another folder

    def run(self, words: Sequence[str]) -> int:
        """Run the sweep that these words describe. Returns its exit code.

        Raises UserError if nothing can start.
        """
        planned = jobs.planned(self.context, self.config, words, self.limits)
        announcements.fewer_parts(planned, self.limits.split_runs)
        if self.limits.dry_run:
            announcements.plan(planned, split.outcomes(planned, self.directory))
            return OK
        with opened(self.directory):
            state.begin(self.directory, sys.argv[1:], planned)
            return self._run(planned)

    def _run(self, planned: list[Planned]) -> int:
        rundir.link_latest(self.directory, Path(str(self.config.output)))
        work = Work(self.context, self.config, self.directory, self.limits)
        interrupted = False
        try:
            self._run_what_is_left(work, planned)
        except KeyboardInterrupt:
            interrupted = True
        if state.is_gone(self.directory):
            return complain(f"{self.directory}: was removed while the sweep wrote to it", FAILED)
        outcomes = work.outcomes(planned)
        code = INTERRUPTED if interrupted else exit_code(split.whole(job, outcomes) for job in planned)
        try:
            table.write_all(self.directory, planned, outcomes, self.limits.repeats)
            notes = self._plots(planned, outcomes)
        except OSError as error:
            notes = [f"{error.filename}: {error.strerror}; free some space and resume, to write what is missing"]
            code = max(code, FAILED)
        notes += announcements.differing_plugins(outcomes)
        announcements.summary(self.directory, planned, outcomes, self.limits.repeats, notes)
        write_page(self.directory)
        if interrupted:
            complain(f"interrupted; continue with estlab sweep --resume {pasted(self.directory)}")
        return code

    def _run_what_is_left(self, work: Work, planned: list[Planned]) -> None:
        before = work.outcomes(planned)
        left = [unit for unit in split.units(planned) if not before[unit.name].whole]
        work.claim(left)
        announcements.resumed(self.directory, planned, before)
        with work.unstopped(), work.workers(left), watched(self.directory, len(before)) as expect:
            expect([unit.name for unit in left], len(before) - len(left))
            work.run(left)

    def _plots(self, planned: list[Planned], outcomes: dict[str, Outcome]) -> list[str]:
        if not self.config.plots:
            return []
        return table.draw_all(self.directory, planned, outcomes, self.limits.repeats, self.limits.zip)


def exit_code(outcomes: Iterable[Outcome]) -> int:
    """0 all ok, 3 some failed, 1 none ok, 2 none could start."""
    found = list(outcomes)
    ok = sum(outcome.state == "ok" for outcome in found)
    if ok:
        return OK if ok == len(found) else SOME_FAILED
    return USAGE if all(outcome.code == USAGE for outcome in found) else FAILED
