"""The only way to run an experiment: a request, executed in the directory of a run."""

import contextlib
import errno
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from estlab import rundir
from estlab.config import expectations
from estlab.config.build import build
from estlab.config.expectations import Finding
from estlab.config.settings import Names, Settings
from estlab.errors import IncompleteError, PluginError, UserError, WorkerLostError, frames, is_lack_of_memory
from estlab.experiment import experiment
from estlab.experiment.compatibility import check
from estlab.experiment.compute import Progress
from estlab.experiment.experiment import Show
from estlab.launch.launcher import FAILED, INTERRUPTED, OK, USAGE, complain, pasted
from estlab.rundir import RunDirectory, State

# What to do about a file of the run that cannot be written, by the system's error number.
_REMEDIES = {
    errno.ENOSPC: "free some space, or set output to another disk",
    errno.EDQUOT: "free some space, or set output to another disk",
    errno.ENOENT: "do not move its directory until the run has ended",
    errno.EINVAL: "remove what is in its place",
    errno.EISDIR: "remove what is in its place",
    errno.EROFS: "set output to another disk",
    errno.EIO: "the disk is failing, set output to another",
    errno.ESTALE: "set output to another disk",
    errno.EMFILE: "raise the limit of open files, for example ulimit -n 1024",
    errno.ENFILE: "the system has too many files open",
    errno.EFBIG: "raise the limit of file sizes, for example ulimit -f unlimited",
}


@dataclass(frozen=True)
class Request:
    """A requested experiment, as plain data for any process.

    plain: its resolved configuration. config, overrides: the texts of config.yaml and overrides.yaml. command: the
    words typed for it.
    """

    plain: dict[str, Any]
    names: Names
    config: str
    overrides: str
    command: list[str]

    def settings(self) -> Settings:
        """Its configuration as objects.

        Raises UserError for an invalid one, or if its parts do not fit together.
        """
        settings = build(self.plain, self.names)
        check(settings)
        return settings


@dataclass(frozen=True)
class Audience:
    """Who follows a run; unless said otherwise, a person at a terminal.

    progress, show: see estlab.experiment.experiment.run. complain: is given one line on what is wrong and the exit
    code, which it returns. on_error: is given the exception for which a run failed.
    """

    progress: Progress | None = None
    show: Show | None = None
    complain: Callable[[str, int], int] = complain
    on_error: Callable[[BaseException], object] = id


def execute(
    request: Request,
    directory: RunDirectory,
    settings: Settings | None = None,
    on_end: Callable[[list[Finding]], object] | None = None,
    audience: Audience = Audience(),
) -> int:
    """Run it in this directory and set its final status. Returns the exit code. Only an interruption is raised.

    settings: those of the request, if they already exist. on_end: receives the findings about expectations, once
    everything except the status is written.
    """

    def work() -> str:
        directory.write_text(rundir.CONFIG, request.config)
        directory.write_text(rundir.OVERRIDES, request.overrides)
        findings = experiment.run(
            settings or request.settings(), directory, request.command, audience.progress, audience.show
        )
        if on_end:
            on_end(findings)
        return expectations.unmet(findings)

    page = request.plain.get("report") is True and not request.plain.get("part")
    return concluded(directory, work, page, audience)


def concluded(directory: RunDirectory, work: Callable[[], str], page: bool, audience: Audience) -> int:
    """Do the work of a run, logged, and set its final status. Returns the exit code. Only an interruption is raised.

    work: returns the expectations not met, empty if all were. page: whether to write report.html.
    """
    try:
        with directory.logged():
            unmet = work()
            directory.sync()
    except KeyboardInterrupt:
        with contextlib.suppress(OSError):
            directory.finish("interrupted", "interrupted by the user", INTERRUPTED)
        raise
    except (Exception, SystemExit) as error:
        audience.on_error(error)
        code = USAGE if isinstance(error, UserError) else FAILED
        return _ended(directory, "failed", _reason(error, directory.path / rundir.LOG), code, audience)
    else:
        return _ended(directory, "unmet" if unmet else "ok", unmet, FAILED if unmet else OK, audience)
    finally:
        # Last, because it shows the status too.
        if page and directory.is_there():
            write_page(directory.path, audience.complain)


def _ended(directory: RunDirectory, state: State, message: str, code: int, audience: Audience) -> int:
    """Set the final status and print what is wrong. Returns the exit code, that of a failure if it cannot be set."""
    try:
        directory.finish(state, message, code)
    except OSError as error:
        message, code = message or _reason(error, directory.path / rundir.LOG), code or FAILED
        audience.on_error(error)
    return audience.complain(message, code) if message else code


def write_page(folder: Path, complain: Callable[[str, int], int] = complain) -> None:
    """Write report.html. If the disk has no room for it, the run's outcome stays the same."""
    from estlab.report import page

    try:
        page.write(folder)
    except OSError as error:
        complain(
            f"{error.filename}: {error.strerror}; the page is missing; draw it later with estlab report "
            f"{pasted(folder)}",
            FAILED,
        )
    except Exception as error:
        complain(
            f"{folder}: report.html is missing ({type(error).__name__}: {error}); everything else is unchanged", FAILED
        )


def _reason(error: BaseException, log: Path) -> str:
    """Why a run failed and what to do, in one line."""
    if isinstance(error, (UserError, WorkerLostError, IncompleteError)):
        return str(error)
    if isinstance(error, PluginError):
        return f"{error}; the traceback is in {log}"
    if is_lack_of_memory(error):
        return "out of memory; lower block_runs, cores, runs, keep_runs or scenario.duration"
    if isinstance(error, OSError):
        why = error.strerror or str(error) or type(error).__name__
        if not _of_directory(error, log.parent):
            where = f"{error.filename}: " if error.filename else ""
            return f"{where}{why}; the traceback is in {log}"
        remedy = _REMEDIES.get(error.errno or 0, "check its permissions")
        return f"{error.filename or log.parent}: {why}; the run is incomplete, {remedy}"
    said = " ".join(str(error).split())
    return f"internal error, {type(error).__name__}: {said}; the traceback is in {log}"


def _of_directory(error: OSError, folder: Path) -> bool:
    """Whether the run directory is what fails, by the function that raised the error, or by the path that it names."""
    named = isinstance(error.filename, str) and Path(error.filename).is_relative_to(folder)
    return named or any(frame.module.startswith("estlab.rundir") for frame in frames(error))
