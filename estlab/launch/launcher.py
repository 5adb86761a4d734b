"""From the rest of a command line to jobs, through Hydra. Only this package knows Hydra."""

import contextlib
import errno
import os
import shlex
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from estlab.config.locations import conf_folder
from estlab.errors import (
    NO_MEMORY,
    IncompleteError,
    PluginError,
    UserError,
    WorkerLostError,
    frames,
    is_lack_of_memory,
    printable,
)
from estlab.launch.arguments import prepared
from estlab.launch.error_messages import one_line

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from estlab.config.expectations import Finding
    from estlab.rundir import RunDirectory, State

_BEGAN = time.time()

OK, FAILED, USAGE, INTERRUPTED = 0, 1, 2, 130

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


def pasted(path: Path) -> str:
    """A path in the form that a shell accepts."""
    return shlex.quote(str(path))


def complain(message: str, code: int = USAGE) -> int:
    print(f"estlab: {printable(message)}", file=sys.stderr)
    return code


def launch(arguments: list[str], job: Callable[["DictConfig"], int]) -> int:
    """Pass the command line to Hydra and its configuration to the job. Returns the worst job's exit code."""
    import hydra
    from hydra.errors import HydraException

    from estlab.launch import composition

    traceback_wanted = os.environ.get("HYDRA_FULL_ERROR", "0") != "0"
    codes: list[int] = []

    def task(config: "DictConfig") -> None:
        try:
            codes.append(job(config))
        except Exception as error:
            if traceback_wanted:
                raise
            short = is_lack_of_memory(error)
            codes.append(complain(NO_MEMORY, FAILED) if short else complain(one_line(error, taken)))

    taken = prepared(arguments)
    sys.argv = ["estlab", *taken]
    try:
        # Hydra prints errors over several lines and exits with 1; with this variable it raises them, and we print one
        # line.
        os.environ["HYDRA_FULL_ERROR"] = "1"
        composition.install()
        hydra.main(config_path=str(conf_folder()), config_name="config", version_base="1.3")(task)()
    except HydraException as error:
        # Before OSError, its base class: a missing configuration.
        if traceback_wanted:
            raise
        raise UserError(one_line(error, taken)) from error
    except OSError as error:
        where = error.filename or "the current folder"
        raise UserError(f"{where}: cannot be used ({error.strerror}); set output or --config-dir to another") from error
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else OK
    except Exception as error:
        if traceback_wanted or is_lack_of_memory(error):
            raise
        raise UserError(one_line(error, taken)) from error
    finally:
        os.environ["HYDRA_FULL_ERROR"] = "1" if traceback_wanted else "0"
    return max(codes, default=OK)


def run_job(command: list[str], config: "DictConfig", told: "Callable[[list[Finding]], object] | None" = None) -> int:
    """One run: its exit code. Says what is wrong in one line and never raises but for an interruption.

    told: is given what was found of what was expected.
    """
    from hydra.core.hydra_config import HydraConfig
    from omegaconf import OmegaConf

    from estlab import rundir
    from estlab.config import expectations
    from estlab.experiment import experiment
    from estlab.experiment.compatibility import check
    from estlab.launch import composed

    folder = Path(composed.raw(HydraConfig.get().runtime)["output_dir"])
    try:
        settings, names = composed.settings_of(config)
        check(settings, names)
        directory = rundir.RunDirectory(folder)
    except BaseException:
        remove_if_ours(folder, Path(str(config.output)))
        raise

    def work() -> str:
        directory.write_text(rundir.CONFIG, OmegaConf.to_yaml(config, resolve=True))
        directory.write_text(rundir.OVERRIDES, OmegaConf.to_yaml(HydraConfig.get().overrides.task))
        directory.link_latest(Path(settings.output))
        findings = experiment.run(settings, names, directory, command)
        if told:
            told(findings)
        return expectations.unmet(findings)

    return concluded(directory, work, settings.report and settings.part is None)


def concluded(directory: "RunDirectory", work: Callable[[], str], page: bool) -> int:
    """Do the work of a run, logged, and set its final status; the exit code. It raises an interruption alone.

    work: gives what was expected and not found, nothing if all was. page: whether to write report.html.
    """
    try:
        with directory.logged():
            unmet = work()
    except KeyboardInterrupt:
        with contextlib.suppress(OSError):
            directory.finish("interrupted", "interrupted by the user", INTERRUPTED)
        raise
    except (Exception, SystemExit) as error:
        code = USAGE if isinstance(error, UserError) else FAILED
        return _ended(directory, "failed", _reason(error, directory.path / "log.txt"), code)
    else:
        return _ended(directory, "unmet" if unmet else "ok", unmet, FAILED if unmet else OK)
    finally:
        # Last, since it shows the status too.
        if page and directory.is_there():
            write_page(directory.path)


def _ended(directory: "RunDirectory", state: "State", message: str, code: int) -> int:
    """Set the final status and print what is wrong. Returns the exit code, that of a failure if it cannot be set."""
    try:
        directory.finish(state, message, code)
    except OSError as error:
        message, code = message or _reason(error, directory.path / "log.txt"), code or FAILED
    return complain(message, code) if message else code


def write_page(folder: Path) -> None:
    """Write report.html. If the disk has no room for it, the run's outcome stays the same."""
    from estlab.report import page

    try:
        page.write(folder)
    except OSError as error:
        complain(
            f"{error.filename}: {error.strerror}; the page is missing; draw it later with estlab report "
            f"{pasted(folder)}"
        )
    except Exception as error:
        complain(f"{folder}: report.html is missing ({type(error).__name__}: {error}); everything else is unchanged")


def simulate_job(config: "DictConfig") -> int:
    """Write simulated data. Returns the exit code.

    Raises UserError for a configuration without data to simulate.
    """
    from estlab.experiment.simulate import simulate
    from estlab.launch import composed

    settings, names = composed.settings_of(config)
    if not settings.data.path:
        raise UserError("data.path is required: the folder to write to, for example data.path=mine")
    for path in simulate(settings, names):
        print(printable(str(path)))
    return OK


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


def remove_if_ours(folder: Path, output: Path) -> None:
    """Hydra makes the run directory before the configuration is checked; leave none behind for a typing error.

    Removes only directories that are empty and were made since this process began, and none outside ``output`` except
    the run's own.
    """
    with contextlib.suppress(OSError):
        if folder.stat().st_ctime >= _BEGAN and folder.resolve() not in (Path.cwd(), *Path.cwd().parents):
            folder.rmdir()
            if folder.parent.resolve().parent == output.resolve():
                folder.parent.rmdir()
