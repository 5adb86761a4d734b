"""Runs what is left of a sweep, by any of Hydra's launchers, until every job has ended or must not be retried."""

import contextlib
import errno
import importlib
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from estlab import rundir
from estlab.config.groups import SweepSettings
from estlab.errors import UserError
from estlab.launch.quoting import literal
from estlab.parallel import cores
from estlab.sweeps import state
from estlab.sweeps.forked import Forked
from estlab.sweeps.job import job_of, perform, task
from estlab.sweeps.state import Planned

if TYPE_CHECKING:
    from collections.abc import Sequence as Returns

    from hydra.core.utils import JobReturn
    from hydra.types import HydraContext
    from omegaconf import DictConfig

_LOST = "its process ended without a message: it was killed, or memory ran out"


class Rounds:
    """The launcher gets everything that is left. Jobs that did not start, or were lost with their worker, go again."""

    def __init__(self, context: "HydraContext", config: "DictConfig", sweep: Path, limits: SweepSettings) -> None:
        from omegaconf import open_dict, read_write

        self.context, self.config, self.sweep, self.limits = context, config, sweep, limits
        with read_write(config), open_dict(config):
            config.hydra.sweep.dir = literal(str(sweep))
        # Errors of jobs without a directory, if there is no room for one.
        self.errors: dict[str, str] = {}
        self._forked: Forked | None = None

    @contextmanager
    def workers(self, left: "Sequence[Planned]") -> Iterator[None]:
        """In the body, the first round that runs is of these jobs, on all cores if they are run on this machine."""

        def work(number: int) -> str:
            try:
                perform(job_of(left[number], self.sweep, alone=False), ours=True)
            except Exception as error:
                return _one_line(error)
            return ""

        count = self._workers_of(len(left))
        if count > 1:
            importlib.import_module("estlab.experiment.experiment")  # once for all
        with Forked(work, len(left), count) as self._forked:
            yield

    def _workers_of(self, jobs: int) -> int:
        """How many processes run so many jobs; one where a launcher was chosen, or Hydra has more to do for a job."""
        hydra, chosen = self.config.hydra, self.config.hydra.overrides.hydra
        asked = any(str(word).startswith("hydra/launcher=") for word in chosen)
        if asked or not self._in_turn or hydra.callbacks or hydra.job.chdir or hydra.job.env_set:
            return 1
        usable = cores.usable()
        # Of fewer jobs than cores, each has all cores in its turn.
        return min(self.limits.workers or (usable if jobs >= usable else 1), jobs)

    def run(self, left: list[Planned]) -> None:
        """Run these jobs. Their directories show how it went, and ``errors`` where there is none.

        Raises UserError if the launcher itself cannot start.
        """
        deaths: Counter[str] = Counter()
        while left and not self._stopped():
            self._launch(left)
            lost = [job.name for job in left if self._is_lost(job)]
            deaths.update(lost)
            left = [job for job in left if self._may_go_again(job, deaths[job.name] if job.name in lost else None)]

    def _launch(self, jobs: "Sequence[Planned]") -> None:
        if self._forked and self._forked.ready:
            for number, reason in self._forked.run().items():
                if self._has_not_begun(jobs[number]) and not self._stopped():
                    self._fail(jobs[number], reason)
            return
        try:
            returns = self._launched(jobs)
        except UserError:
            raise
        except Exception as error:
            self._not_launched(jobs, error)
            return
        for job, result in zip(jobs, returns, strict=True):
            if self._has_not_begun(job) and not self._stopped():
                found = getattr(result, "_return_value", None)
                self._fail(job, _one_line(found) if isinstance(found, Exception) else "its launcher never started it")

    def _launched(self, jobs: "Sequence[Planned]") -> "Returns[JobReturn]":
        from hydra.core.hydra_config import HydraConfig
        from hydra.core.plugins import Plugins

        from estlab.sweeps import ready

        # joblib and submitit ask for a job's name before they set its configuration.
        HydraConfig.instance().set_config(self.config)
        launcher = Plugins.instance().instantiate_launcher(
            hydra_context=ready.context_of(self.context), task_function=task, config=self.config
        )
        words = [[ready.packed(job_of(job, self.sweep, self._in_turn))] for job in jobs]
        return launcher.launch(words, initial_job_idx=jobs[0].number)

    @property
    def _in_turn(self) -> bool:
        """Whether the launcher is Hydra's basic one, which runs jobs in this process one after another."""
        return str(self.config.hydra.launcher["_target_"]).endswith("BasicLauncher")

    def _not_launched(self, jobs: "Sequence[Planned]", error: Exception) -> None:
        """The launcher gave up. If no job began, the next one may still run; another engine cannot start at all."""
        if not all(self._has_not_begun(job) for job in jobs):
            return  # a worker died, and with some launchers its whole pool; the rest goes again
        if not self._in_turn:
            name = self.config.hydra.runtime.choices["hydra/launcher"]
            raise UserError(f"hydra/launcher={name} cannot start: {_one_line(error)}") from error
        if len(jobs) == 1:
            self._fail(jobs[0], _one_line(error))
            return
        for job in jobs:
            if not self._stopped():
                self._launch([job])

    def _may_go_again(self, job: Planned, deaths: int | None) -> bool:
        """Whether it never began, or was lost with its worker and is not known to be the cause."""
        if job.name in self.errors:
            return False
        return self._has_not_begun(job) if deaths is None else deaths <= max(1, self.limits.retries)

    def _is_lost(self, job: Planned) -> bool:
        """Whether its worker is gone. A worker that is still alive is waited for."""
        while state.at_work(self.sweep, job.name):
            time.sleep(0.1)
        found = state.outcome(self.sweep, job.name).state
        if found == "running":
            with contextlib.suppress(OSError):
                rundir.end(self.sweep, job.name, _LOST)
        return found in ("running", "interrupted")

    def _fail(self, job: Planned, message: str) -> None:
        """Record in its directory why a job never began, or remember it if there is no room even for that."""
        try:
            rundir.end(self.sweep, job.name, message)
        except OSError:
            self.errors[job.name] = message

    def _has_not_begun(self, job: Planned) -> bool:
        return state.outcome(self.sweep, job.name).state == "left"

    def _stopped(self) -> bool:
        return state.stopped(self.sweep)


def _one_line(error: Exception) -> str:
    if isinstance(error, OSError):
        # An error that names a file says which; an engine uses shared memory too.
        unnamed = "shared memory (/dev/shm)" if error.errno == errno.ENOSPC else "the system"
        return f"{error.filename or unnamed}: {error.strerror or error}"
    message = " ".join(str(error).split())
    return message if isinstance(error, UserError) else f"{type(error).__name__}: {message}"
