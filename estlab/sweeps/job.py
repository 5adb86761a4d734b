"""One job of a sweep, as engines hand it to their workers. Only its directory shows how it went."""

import contextlib
import io
import os
import pickle
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from estlab.config.settings import Names
from estlab.launch.execute import Request, execute
from estlab.launch.launcher import OK, USAGE
from estlab.launch.path_arguments import as_typed
from estlab.rundir import RunDirectory, process
from estlab.rundir.layout import OUTPUT
from estlab.sweeps import state
from estlab.sweeps.state import Planned

if TYPE_CHECKING:
    from omegaconf import DictConfig


_EVERY = 0.5  # seconds between checks of the sweep's process

# Hydra's configuration, the standard streams and the log belong to the process, so its threads take turns.
_ONE_AT_A_TIME = threading.Lock()


@dataclass(frozen=True)
class Job:
    """Everything that a job needs, as plain data for any process.

    plain: its resolved configuration. words: what is typed for it. hydra_job: what Hydra calls hydra.job of it. alone:
    whether it may take all cores, no other job running beside it.
    """

    sweep: str
    name: str
    plain: dict[str, Any]
    names: Names
    words: tuple[str, ...]
    hydra_job: dict[str, Any]
    alone: bool

    @property
    def request(self) -> Request:
        """What it asks for. Where its parts lie is no part of that: it may be typed, and gives the same, without."""
        words = [as_typed(word) for word in self.words if not word.startswith("sweep.")]
        cores = {"cores": 1} if self.plain["cores"] is None and not self.alone else {}
        return Request(
            plain=self.plain | cores,
            names=self.names,
            config=_text(self.plain | {"parts": []}),
            overrides=_text(list(self.words)),
            command=["estlab", "run", *words],
        )

    @property
    def fingerprint(self) -> str:
        """What decides its figures."""
        return state.fingerprint(self.plain, self.names.scenario, self.names.filter)

    def run(self) -> int:
        """Run in its directory, which must not exist. Returns the exit code. Only an interruption is raised."""
        facts: dict[str, Any] = {"fingerprint": self.fingerprint}
        if parts := self.plain["parts"]:
            took = [state.outcome(Path(folder), "").wall_time or 0.0 for folder in parts]
            facts |= {"parts": len(took), state.PARTS_TOOK: round(sum(took), 3)}
        directory = RunDirectory(Path(self.sweep, self.name), Path(self.sweep), **facts)
        with _output(directory):
            return execute(self.request, directory)


def task(config: "DictConfig") -> int:
    """Run the ready job that one of Hydra's launchers was given. Returns the last attempt's exit code."""
    from hydra.core.hydra_config import HydraConfig

    from estlab.sweeps import ready

    return perform(ready.job_of(config), _is_ours(HydraConfig.get().launcher))


def perform(job: Job, ours: bool) -> int:
    """Run a job, with retries. Returns the last attempt's exit code.

    ours: whether this process is there for the sweep alone, and ends with it.
    """
    with _ONE_AT_A_TIME:
        sweep, name = Path(job.sweep), job.name
        if state.stopped(sweep):
            with contextlib.suppress(OSError):
                (sweep / name).rmdir()  # Hydra made it; a folder that is not empty stays
            return OK
        limits = job.plain["sweep"]
        if ours:
            _end_with(sweep)
        code = OK
        for _ in range(1 + limits["retries"]):
            if state.at_work(sweep, name) or _is_done(job):
                return OK
            state.set_aside(sweep, name)
            code = _attempt(job, limits["timeout"])
            if code in (OK, USAGE) or _is_done(job):  # it may be complete and unmet
                break
        if code != OK and limits["fail_fast"]:
            state.stop(sweep)
        return code


def job_of(planned: Planned, sweep: Path, alone: bool) -> Job:
    """A planned job as its worker is given it. alone: whether no other runs beside it."""
    plain, names, words, hydra_job = pickle.loads(planned.composed)
    if part := planned.own.get("part"):
        words = (*words, f"part=[{part[0]},{part[1]}]")
    return Job(str(sweep), planned.name, plain | planned.own, names, words, hydra_job, alone)


def _text(content: Any) -> str:
    """YAML as OmegaConf writes it, of plain data in which ${...} stands for itself."""
    import yaml
    from omegaconf._utils import get_omega_conf_dumper

    return yaml.dump(
        content, default_flow_style=False, allow_unicode=True, sort_keys=False, Dumper=get_omega_conf_dumper()
    )


def _is_ours(launcher: "DictConfig") -> bool:
    """Whether the worker exists only for this sweep, and does not belong to a cluster that somebody else started."""
    ours = ("BasicLauncher", "JoblibLauncher", "LocalLauncher", "DaskLauncher")
    return str(launcher["_target_"]).endswith(ours) and launcher.get("address") is None


@cache
def _end_with(sweep: Path) -> None:
    """End this process when the sweep's process has ended, for any reason: nobody waits for the results."""
    marks = state.holder(sweep)
    if marks.get("pid") != os.getpid():
        threading.Thread(target=_end_once_gone, args=[marks], daemon=True).start()


def _end_once_gone(marks: dict[str, Any]) -> NoReturn:
    while process.life(marks) != "gone":
        time.sleep(_EVERY)
    os._exit(1)


def _is_done(job: Job) -> bool:
    """Whether another worker, believed dead, has completed it after all."""
    return state.outcome(Path(job.sweep), job.name, job.fingerprint).whole


def _attempt(job: Job, limit: float | None) -> int:
    if limit is None:
        return job.run()
    from estlab.sweeps.child import run_for

    return run_for(job, limit)


@contextmanager
def _output(directory: RunDirectory) -> Iterator[None]:
    """What the job prints, stored in a file of its directory: nobody wants a hundred summaries of a sweep."""
    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            yield
    finally:
        with contextlib.suppress(OSError):
            directory.write_text(OUTPUT, printed.getvalue())
