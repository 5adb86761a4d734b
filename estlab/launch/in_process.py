"""Composes a configuration without a command line, in a process that may use Hydra for something else."""

import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from estlab.config.locations import conf_folder
from estlab.errors import PluginError, UserError, is_lack_of_memory
from estlab.launch.arguments import CONFIG_DIR, is_sweep, parted, prepared
from estlab.launch.error_messages import one_line

if TYPE_CHECKING:
    from estlab.launch.execute import Request

# Hydra, the log and the warning filters belong to the process, so its threads take turns.
ONE_AT_A_TIME = threading.RLock()


def compose(arguments: Sequence[str]) -> "tuple[Request, Path]":
    """What ``estlab run`` would run for these arguments, and where; nothing of Hydra's stays in the process.

    Raises UserError, as on the command line, if it cannot be composed.
    """
    from hydra.core.global_hydra import GlobalHydra

    with hydra_apart():
        taken = prepared(list(arguments))
        try:
            return _composed(taken, ["estlab", "run", *arguments])
        except PluginError:
            raise
        except Exception as error:
            if is_lack_of_memory(error):
                raise
            GlobalHydra.instance().clear()  # to find out what a key may have meant, Hydra composes anew
            raise UserError(one_line(error, taken)) from None


@contextmanager
def hydra_apart() -> Iterator[None]:
    """Hydra for the body only: the process's own state of Hydra is put aside, and restored afterwards."""
    from hydra.core.global_hydra import GlobalHydra
    from hydra.core.hydra_config import HydraConfig
    from hydra.core.singleton import Singleton
    from hydra.core.utils import JobRuntime
    from hydra.version import VersionBase

    from estlab.launch import resolvers

    kinds: tuple[Any, ...] = (GlobalHydra, HydraConfig, JobRuntime, VersionBase)
    with ONE_AT_A_TIME:
        theirs = {kind: Singleton._instances.pop(kind) for kind in kinds if kind in Singleton._instances}
        path = list(sys.path)
        try:
            with resolvers.registered():
                from estlab.launch import composition

                with composition.installed():
                    yield
        finally:
            for kind in kinds:
                Singleton._instances.pop(kind, None)
            Singleton._instances.update(theirs)
            sys.path[:] = path


def _composed(taken: Sequence[str], command: list[str]) -> "tuple[Request, Path]":
    import hydra._internal.hydra as hydras_own
    from hydra import version
    from hydra._internal.utils import create_config_search_path
    from hydra.core.config_search_path import SearchPathQuery
    from hydra.core.hydra_config import HydraConfig
    from hydra.types import RunMode
    from omegaconf import open_dict, read_write

    from estlab.launch.composed import request_of

    flags, words = parted(taken)
    version.setbase("1.3")
    search_path = create_config_search_path(str(conf_folder()))
    for folder in _config_folders(flags, words):
        search_path.prepend("command-line", f"file://{folder}", SearchPathQuery(provider="schema"))
    hydra = hydras_own.Hydra.create_main_hydra2("estlab", search_path)
    config = hydra.compose_config("config", list(words), RunMode.RUN)
    HydraConfig.instance().set_config(config)
    folder = Path(str(config.hydra.run.dir))
    with read_write(config), open_dict(config):
        del config["hydra"]
    return request_of(config, command), folder


def _config_folders(flags: Sequence[str], words: Sequence[str]) -> list[Path]:
    """The folders of --config-dir. Raises UserError for any other flag, and for a sweep."""
    if is_sweep(flags, words):
        raise UserError("a run is one job; use estlab.sweep for several")
    folders = []
    for flag in flags:
        name, _, value = flag.partition("=")
        if name != CONFIG_DIR[0]:
            raise UserError(f"{flag} belongs to the command line; in Python write keys, and config_dir=FOLDER")
        if not Path(value).is_dir():
            raise UserError(f"{CONFIG_DIR[0]}: there is no folder {value}")
        folders.append(Path(value).absolute())
    return folders
