"""One job of a sweep, as engines hand it to their workers. Only its directory shows how it went."""

import contextlib
import io
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from estlab.launch.composed import described, typed
from estlab.launch.execute import Request, execute
from estlab.launch.launcher import OK, USAGE
from estlab.launch.path_arguments import as_typed
from estlab.rundir import RunDirectory, process
from estlab.rundir.layout import OUTPUT
from estlab.sweeps import state

if TYPE_CHECKING:
    from omegaconf import DictConfig


_EVERY = 0.5  # seconds between checks of the sweep's process

# Hydra's configuration, the standard streams and the log belong to the process, so its threads take turns.
_ONE_AT_A_TIME = threading.Lock()


@dataclass(frozen=True)
class Job:
    """Everything that a job needs, as plain data for any process."""

    sweep: str
    name: str
    request: Request

    @property
    def fingerprint(self) -> str:
        """What decides its figures."""
        names = self.request.names
        return state.fingerprint(self.request.plain, names.scenario, names.filter)

    def run(self) -> int:
        """Run in its directory, which must not exist. Returns the exit code. Only an interruption is raised."""
        facts: dict[str, Any] = {"fingerprint": self.fingerprint}
        if parts := self.request.plain["parts"]:
            took = [state.outcome(Path(folder), "").wall_time or 0.0 for folder in parts]
            facts |= {"parts": len(took), state.PARTS_TOOK: round(sum(took), 3)}
        directory = RunDirectory(Path(self.sweep, self.name), Path(self.sweep), **facts)
        with _output(directory):
            return execute(self.request, directory)


def task(config: "DictConfig") -> int:
    """Run the job of a composed configuration, with retries. Returns the last attempt's exit code."""
    from hydra.core.hydra_config import HydraConfig

    with _ONE_AT_A_TIME:
        sweep, name = Path(HydraConfig.get().sweep.dir), str(HydraConfig.get().sweep.subdir)
        if state.stopped(sweep):
            with contextlib.suppress(OSError):
                (sweep / name).rmdir()  # Hydra made it; a folder that is not empty stays
            return OK
        job = _job(config, sweep, name)
        limits = job.request.plain["sweep"]
        if _is_ours(HydraConfig.get().launcher):
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


def _job(config: "DictConfig", sweep: Path, name: str) -> Job:
    from hydra.core.hydra_config import HydraConfig
    from omegaconf import OmegaConf

    plain, names = described(config)
    if plain["cores"] is None and not str(HydraConfig.get().launcher["_target_"]).endswith("BasicLauncher"):
        plain["cores"] = 1  # the engine already spreads its jobs over the cores
    # The place of a job's parts does not belong to it: the job gives the same when typed without them.
    words = [word for word in typed() if not word.startswith("parts=")]
    request = Request(
        plain=plain,
        names=names,
        config=OmegaConf.to_yaml(OmegaConf.merge(config, {"parts": []}), resolve=True),
        overrides=OmegaConf.to_yaml(words),
        command=["estlab", "run", *(as_typed(word) for word in words if not word.startswith("sweep."))],
    )
    return Job(str(sweep), name, request)


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
