"""From the rest of a command line to jobs, through Hydra. Only this package knows Hydra."""

import contextlib
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
    UserError,
    is_lack_of_memory,
    printable,
)
from estlab.launch.arguments import prepared
from estlab.launch.error_messages import one_line

if TYPE_CHECKING:
    from omegaconf import DictConfig


_BEGAN = time.time()

OK, FAILED, USAGE, INTERRUPTED = 0, 1, 2, 130


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
        with composition.installed():
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
