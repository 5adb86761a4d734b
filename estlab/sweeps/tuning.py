"""Settings chosen by Optuna, each trial a job of a sweep. The trials on the disk, replayed, are the study."""

import json
import sys
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from estlab import rundir
from estlab.config.build import build, nearest, sweep_settings
from estlab.config.settings import Names
from estlab.errors import UserError
from estlab.launch.execute import write_page
from estlab.launch.launcher import FAILED, INTERRUPTED, OK, complain, pasted
from estlab.metrics.objective import Objective
from estlab.record import SMOOTHED
from estlab.sweeps import announcements, jobs, split, state, table, trials
from estlab.sweeps.dimensions import dimension
from estlab.sweeps.progress import watched
from estlab.sweeps.state import Planned
from estlab.sweeps.sweep import SOME_FAILED
from estlab.sweeps.trials import Trial
from estlab.sweeps.work import Work, opened

if TYPE_CHECKING:
    import optuna
    from hydra.types import HydraContext
    from omegaconf import DictConfig


class Tuning:
    """Trials in rounds of sweep.batch. Optuna's suggestions follow from the seed and from earlier results.

    So a stopped tuning is replayed: the suggestions are the same, and those that ended do not run again.
    """

    def __init__(self, context: "HydraContext", config: "DictConfig") -> None:
        from omegaconf import OmegaConf

        self.context, self.config = context, config
        self.limits = sweep_settings(cast(dict[str, Any], OmegaConf.to_container(config.sweep, resolve=True)))
        self.directory = Path(str(config.hydra.sweep.dir)).resolve()
        try:
            self.objective = Objective.parse(str(config.objective))
        except ValueError as error:
            raise UserError(str(error)) from error
        self.trials: list[Trial] = []

    def run(self, words: Sequence[str]) -> int:
        """Run the tuning that these words describe. Returns its exit code.

        Raises UserError if nothing can start.
        """
        fixed, swept = jobs.parsed(self.context, words)
        self.fixed = list(fixed.values())
        self.dimensions = {key: dimension(override) for key, override in swept.items()}
        if not self.dimensions:
            raise UserError(
                "nothing to tune: give a key an interval, such as noise.filter.process_scale='interval(0.2,5)'"
            )
        if self.limits.zip or self.limits.repeats > 1:
            raise UserError(
                "tuning does not support sweep.zip and sweep.repeats; raise runs to make the objective more certain"
            )
        study = self._study()
        first, plain, names = self._suggested(study.ask(self._distributions), 0)
        self._check(plain, names)
        announcements.fewer_parts([first], self.limits.split_runs)
        if self.limits.dry_run:
            announcements.plan([first], split.outcomes([first], self.directory))
            print(f"the first of {self.limits.trials} trials; the others depend on its result")
            return OK
        with opened(self.directory):
            self.mark = self._mark(first)
            state.begin(self.directory, sys.argv[1:], [], self.mark)
            return self._run(len(split.units([first])), float(plain["verdict"]["lost"]))

    @property
    def _distributions(self) -> "dict[str, optuna.distributions.BaseDistribution]":
        return {key: one.distribution() for key, one in self.dimensions.items()}

    def _study(self) -> "optuna.Study":
        import optuna

        optuna.logging.set_verbosity(optuna.logging.WARNING)
        return optuna.create_study(sampler=optuna.samplers.TPESampler(seed=jobs.whole_seed(self.config.seed) % 2**32))

    def _mark(self, first: Planned) -> str:
        """What determines the suggestions, apart from the results: another version of Optuna may suggest others."""
        import optuna

        decides = [first.name, first.fingerprint, repr(self.dimensions), repr(self.objective), self.limits.batch]
        return f"Optuna {optuna.__version__}, {sha256(json.dumps(decides).encode()).hexdigest()[:16]}"

    def _check(self, plain: dict[str, Any], names: Names) -> None:
        """Raise UserError if no trial could have such an objective."""
        settings, wanted = build(plain, names), self.objective
        space = settings.scenario.space
        components = [*space.names, *(["position"] if space.position else [])]
        if wanted.name == "rmse" and wanted.component not in components:
            near = nearest(wanted.component, components) or f"; {names.scenario} has {', '.join(components)}"
            raise UserError(f"objective: there is no component {wanted.component}{near}")
        filters = [name + end for name in settings.filters for end in ("", SMOOTHED)[: 1 + settings.smooth]]
        if wanted.filter and wanted.filter not in filters and "filter" not in self.dimensions:
            raise UserError(f"objective: there is no filter {wanted.filter} here (one of {', '.join(filters)})")

    def _suggested(self, asked: "optuna.Trial", number: int) -> tuple[Planned, dict[str, Any], Names]:
        values = {key: one.word(asked.params[key]) for key, one in self.dimensions.items()}
        chosen = [f"{key}={value}" for key, value in values.items()]
        bare = {key.lstrip("+"): value for key, value in values.items()}
        return jobs.composed(self.context, self.config, number, [*self.fixed, *chosen], bare, self.limits)

    def _run(self, units: int, lost: float) -> int:
        rundir.link_latest(self.directory, Path(str(self.config.output)))
        work = Work(self.context, self.config, self.directory, self.limits)
        interrupted = False
        try:
            with work.unstopped(), watched(self.directory, units * self.limits.trials) as expect:
                study = self._study()
                while len(self.trials) < self.limits.trials and not work.stopped:
                    self._round(study, work, expect, lost)
        except KeyboardInterrupt:
            interrupted = True
        return self._conclude(work, interrupted)

    def _round(self, study: "optuna.Study", work: Work, expect: Any, lost: float) -> None:
        from optuna.trial import TrialState

        begin = len(self.trials)
        numbers = range(begin, min(begin + self.limits.batch, self.limits.trials))
        asked = [study.ask(self._distributions) for _ in numbers]
        planned = [self._suggested(one, number)[0] for one, number in zip(asked, numbers, strict=True)]
        self.trials += [Trial(job) for job in planned]
        before = work.outcomes(planned)
        # A failed trial stays failed on resuming: later trials were chosen knowing it.
        open_ones = [job for job in planned if split.whole(job, before).state != "failed"]
        left = [unit for unit in split.units(open_ones) if not before[unit.name].whole]
        work.claim(left)
        announcements.damaged(before)
        expect([unit.name for unit in left], len(before) - len(left))
        work.run(left)
        outcomes = work.outcomes(planned)
        for one, job, number in zip(asked, planned, numbers, strict=True):
            trial = self.trials[number] = trials.concluded(job, split.whole(job, outcomes), self.objective, lost)
            if trial.objective is None:
                study.tell(one, state=TrialState.FAIL)
            else:
                study.tell(one, trial.objective)

    def _conclude(self, work: Work, interrupted: bool) -> int:
        if state.is_gone(self.directory):
            return complain(f"{self.directory}: was removed while the sweep wrote to it", FAILED)
        planned = [trial.job for trial in self.trials]
        outcomes = work.outcomes(planned)
        counted = [trial.state == "ok" for trial in self.trials]
        some = SOME_FAILED if any(counted) else FAILED
        code = INTERRUPTED if interrupted else OK if all(counted) and len(counted) == self.limits.trials else some
        notes = trials.edges(self.trials, self.dimensions)
        try:
            state.write_plan(self.directory, sys.argv[1:], planned, self.mark)
            table.write_all(self.directory, planned, outcomes, repeats=1)
            trials.write(self.directory, self.trials)
            if self.config.plots:
                notes += trials.draw(self.directory, self.trials, self.objective)
        except OSError as error:
            notes = [f"{error.filename}: {error.strerror}; free some space and resume, to write what is missing"]
            code = max(code, FAILED)
        notes += announcements.differing_plugins(outcomes)
        announcements.failures(self.directory, [(unit.name, outcomes[unit.name]) for unit in split.units(planned)])
        trials.summary(self.directory, self.trials, self.objective, self.limits.trials, notes)
        write_page(self.directory)
        if interrupted:
            complain(f"interrupted; continue with estlab sweep --resume {pasted(self.directory)}")
        return code
