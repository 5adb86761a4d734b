"""From the rest of a command line to jobs, by Hydra. The only place that knows it."""

import contextlib
import os
import re
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, cast

from estlab.errors import UserError

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from estlab.config import Settings
    from estlab.experiment import Names

OK, FAILED, USAGE, INTERRUPTED = 0, 1, 2, 130

# What a title says anyway, or what changes nothing in the figures.
_TOLD = (
    "scenario=",
    "filter=",
    "runs=",
    "steps=",
    "seed=",
    "data",
    "plots=",
    "output=",
    "plugins=",
    "keep_runs=",
    "block_runs=",
)


def conf_folder() -> Path:
    """conf/, beside the package in a checkout and inside it in an installed wheel."""
    inside = Path(__file__).parent / "conf"
    return inside if inside.is_dir() else Path(__file__).parent.parent / "conf"


def complain(message: str, code: int = USAGE) -> int:
    print(f"estlab: {message}", file=sys.stderr)
    return code


def launch(arguments: list[str], job: Callable[["DictConfig"], int]) -> int:
    """Hand the rest of the command line to Hydra and its configuration to the job; the worst job's exit code."""
    import hydra
    from hydra.errors import HydraException
    from omegaconf.errors import OmegaConfBaseException

    traceback_wanted = os.environ.get("HYDRA_FULL_ERROR", "0") != "0"
    signal.signal(signal.SIGTERM, _interrupt)
    codes: list[int] = []

    def task(config: "DictConfig") -> None:
        try:
            codes.append(job(config))
        except UserError as error:
            codes.append(complain(str(error)))

    sys.argv = ["estlab", *_several_filters(arguments)]
    try:
        # Hydra prints errors over several lines and exits with 1; with this it raises them, for us to say in one.
        os.environ["HYDRA_FULL_ERROR"] = "1"
        hydra.main(config_path=str(conf_folder()), config_name="config", version_base="1.3")(task)()
    except (HydraException, OmegaConfBaseException, ValueError) as error:
        if traceback_wanted:
            raise
        raise UserError(_one_line(error, arguments)) from error
    except BrokenPipeError:
        raise
    except OSError as error:
        if traceback_wanted:
            raise
        raise UserError(
            f"{error.filename}: cannot be written ({error.strerror}); set output to another folder"
        ) from error
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else OK
    finally:
        os.environ["HYDRA_FULL_ERROR"] = "1" if traceback_wanted else "0"
    return max(codes, default=OK)


def _several_filters(arguments: list[str]) -> list[str]:
    """filter=[ekf,ukf] as what Hydra takes for it: each in a place of its own under filters."""
    written: list[str] = []
    for argument in arguments:
        if match := re.fullmatch(r"filter=\[([^\]]*)\]", argument):
            names = [name.strip() for name in match[1].split(",") if name.strip()]
            if len(names) != len(set(names)) or not names:
                raise UserError(f"{argument}: name each filter once, for example filter=[ekf,ukf]")
            written += [f"filter={names[0]}", *(f"+filter@filters.{name}={name}" for name in names)]
            written.append(f"hydra.job.name={'-'.join(names)}")
        else:
            written.append(argument)
    return written


def _interrupt(number: int, frame: object) -> NoReturn:
    raise KeyboardInterrupt


def run_job(command: list[str], config: "DictConfig") -> int:
    """One run: its exit code. Says what is wrong in one line and never raises but for an interruption."""
    from hydra.core.hydra_config import HydraConfig
    from omegaconf import OmegaConf

    from estlab import experiment, rundir

    folder = Path(HydraConfig.get().runtime.output_dir)
    try:
        settings, names = _settings(config)
        experiment.check(settings, names)
        directory = rundir.RunDirectory(folder)
    except UserError:
        _remove_if_empty(folder)
        raise
    try:
        with directory.logged():
            directory.write_text(rundir.CONFIG, OmegaConf.to_yaml(config, resolve=True))
            directory.write_text(rundir.OVERRIDES, OmegaConf.to_yaml(HydraConfig.get().overrides.task))
            directory.link_latest(Path(settings.output))
            experiment.run(settings, names, directory, command)
    except KeyboardInterrupt:
        directory.finish("interrupted", "interrupted by the user")
        raise
    except Exception as error:
        message = _reason(error, folder / rundir.LOG)
        directory.finish("failed", message)
        return complain(message, USAGE if isinstance(error, UserError) else FAILED)
    directory.finish("ok")
    return OK


def simulate_job(config: "DictConfig") -> int:
    from estlab import experiment

    for path in experiment.simulate(*_settings(config)):
        print(path)
    return OK


def _settings(config: "DictConfig") -> "tuple[Settings, Names]":
    """The composed configuration as objects, and what the user called them."""
    from hydra.core.hydra_config import HydraConfig
    from omegaconf import OmegaConf

    from estlab.config import build
    from estlab.experiment import Names

    if config.get("plugins"):
        sys.path.insert(
            0, str(Path.cwd())
        )  # an installed command, unlike python -m, does not look where the user stands
    choices = HydraConfig.get().runtime.choices
    plain = OmegaConf.to_container(config, resolve=True)
    changes = tuple(o.lstrip("+") for o in HydraConfig.get().overrides.task if not o.startswith((*_TOLD, "+filter@")))
    return build(cast(dict[str, Any], plain)), Names(choices["scenario"], choices["filter"], changes)


def _reason(error: Exception, log: Path) -> str:
    """Why a run failed and what to do, in one line."""
    if isinstance(error, UserError):
        return str(error)
    if isinstance(error, OSError):
        remedy = "the run is incomplete, make room or set output to another disk"
        return f"{error.filename or log.parent}: {error.strerror}; {remedy}"
    if isinstance(error, MemoryError):
        return "out of memory; lower block_runs, runs or keep_runs"
    return f"internal error, {type(error).__name__}: {error}; the traceback is in {log}"


def _remove_if_empty(folder: Path) -> None:
    """Hydra makes the run directory before the configuration is checked; leave none behind for a typing error."""
    with contextlib.suppress(OSError):
        folder.rmdir()
        folder.parent.rmdir()


def _one_line(error: Exception, arguments: list[str]) -> str:
    """Hydra's and OmegaConf's messages, of several lines, as one that names the key and the nearest known one."""
    from estlab.config import nearest, unknown_key

    text = "\n".join(filter(None, [str(error), str(error.__cause__ or "")]))
    if match := re.search(r"Could not override '([^']+)'", text):
        return unknown_key(match[1].lstrip("+"), _known_keys(arguments))
    if match := re.search(
        r"Could not find '([^']+)'\s*(?:Available options in '[^']+':\s*(.*?)\s*(?:Config search path|$))?",
        text,
        re.DOTALL,
    ):
        group, _, option = match[1].rpartition("/")
        options = (match[2] or "").split()
        return f"there is no {group or 'config'} {option}{nearest(option, options)}" + (
            f" (one of {', '.join(options)})" if options else ""
        )
    return "; ".join(line.strip() for line in str(error).splitlines() if line.strip())


def _known_keys(arguments: list[str]) -> list[str]:
    """Every group and key of the configuration that the group choices among the arguments compose."""
    from hydra import compose, initialize_config_dir
    from hydra.errors import HydraException

    from estlab.config import key_paths

    groups = [folder.name for folder in conf_folder().iterdir() if folder.is_dir() and folder.name != "hydra"]
    chosen = [argument for argument in arguments if argument.partition("=")[0] in groups]
    with initialize_config_dir(str(conf_folder()), version_base="1.3"):
        for overrides in (chosen, []):
            with contextlib.suppress(HydraException):
                return [*groups, *key_paths(compose("config", overrides=overrides))]
    return groups
