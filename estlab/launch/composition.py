"""Checks what Hydra composes, before Hydra makes anything from it."""

import inspect
import pickle
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any

import hydra._internal.core_plugins.file_config_source as hydras_files
import hydra._internal.hydra as hydras_own
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.sources_registry import SourcesRegistry
from hydra.plugins.config_source import ConfigResult
from omegaconf import DictConfig, ListConfig, OmegaConf, open_dict, read_write
from omegaconf.errors import OmegaConfBaseException

from estlab.config.locations import conf_folder
from estlab.config.targets import located
from estlab.errors import UserError
from estlab.launch import resolvers, yaml_bounds
from estlab.launch.path_arguments import PATHS, home
from estlab.launch.shared_compositions import SharedCompositions

# What Hydra calls from its own node: these it takes only from its plugins, which it knows by name.
_PLUGINS = ("hydra.launcher._target_", "hydra.sweeper._target_")
_PLUGIN = re.compile(r"hydra_plugins\.|hydra\._internal\.core_plugins\.")
_HYDRAS_CALLBACK = re.compile(r"hydra\.experimental\.callbacks\.\w+Callback")
# Python's logging calls whatever "()" and "class" name, and imports what follows ext://.
_LOGGERS = re.compile(r"logging\.((Stream|File|Null)Handler|Formatter|handlers\.(Timed)?RotatingFileHandler)")
_COLOURS = "colorlog.ColoredFormatter"
_STREAMS = ("ext://sys.stdout", "ext://sys.stderr")

resolvers.register()  # at import: a worker of a sweep unpickles the loader below, and calls nothing else of estlab


def install() -> None:
    """Make Hydra compose through this module, in this process and in those that receive its jobs."""
    resolvers.register()
    SourcesRegistry.instance().types["file"] = FileConfigSource
    hydras_own.ConfigLoaderImpl = CheckedLoader  # type: ignore[attr-defined]
    hydras_own.Hydra = Hydra  # type: ignore[misc]


@contextmanager
def installed() -> Iterator[None]:
    """The same for the body alone."""
    sources = SourcesRegistry.instance().types
    source, hydra = sources.get("file", hydras_files.FileConfigSource), hydras_own.Hydra
    loader = hydras_own.ConfigLoaderImpl  # type: ignore[attr-defined]
    install()
    try:
        yield
    finally:
        sources["file"], hydras_own.Hydra = source, hydra  # type: ignore[misc]
        hydras_own.ConfigLoaderImpl = loader  # type: ignore[attr-defined]


class Hydra(hydras_own.Hydra):
    """Hydra, without composing everything again just to know its mode: no file of estlab's states one."""

    def get_mode(self, config_name: str | None, overrides: list[str]) -> Any:
        places = {str(place.path) for place in self.config_loader.get_search_path().get_path()}
        ours = {"pkg://hydra.conf", str(conf_folder()), "structured://"}
        if config_name == "config" and places <= ours and not any(map(may_state_a_mode, overrides)):
            return None
        return super().get_mode(config_name, overrides)


def may_state_a_mode(word: str) -> bool:
    """Whether it states a mode, or chooses a file that may: one whose name is not that of a shipped file."""
    key, _, value = word.strip().lstrip("+~").partition("=")
    group = key.partition("@")[0]
    if (conf_folder() / group).is_dir():
        return not re.fullmatch(r"[\w,\[\] ]*", value)
    return "/" in group or bool(re.match(r"hydra(\.mode|\.searchpath|$)", group))


class FileConfigSource(hydras_files.FileConfigSource):
    """A folder of configuration whose files are checked before they are read, and read once for each content.

    Hydra composes twice for a run, and again for each job of a sweep. The class has the name of Hydra's own, because
    Hydra's registry treats a second class of the same name as the first.
    """

    def load_config(self, config_path: str) -> ConfigResult:
        path = Path(self.path) / self._normalize_file_name(config_path)
        if not path.is_file():
            return super().load_config(config_path)
        content = yaml_bounds.checked(path)
        # A copy each time, because Hydra modifies it.
        found: ConfigResult = pickle.loads(_read(self.provider, self.path, config_path, content))
        return found


@lru_cache(maxsize=256)
def _read(provider: str, folder: str, config_path: str, content: bytes) -> bytes:
    """Hydra's parsed form of a file with this content, as a pickle."""
    return pickle.dumps(hydras_files.FileConfigSource(provider, f"file://{folder}").load_config(config_path))


class CheckedLoader(ConfigLoaderImpl):
    """Hydra's loader, except that it expands home directories, and that the node ``hydra`` may call little.

    Hydra configures logging, and makes callbacks, sweeper and launcher, from what this returns.
    """

    def load_configuration(self, *arguments: Any, **options: Any) -> DictConfig:
        config = super().load_configuration(*arguments, **options)
        _write_out_homes(config)
        check(config)
        return config

    def load_sweep_config(self, master_config: DictConfig, sweep_overrides: list[str]) -> DictConfig:
        """The configuration of a job; jobs that differ in numbers alone share a composition."""
        words = [*map(str, master_config.hydra.overrides.hydra), *sweep_overrides]
        compose = partial(super().load_sweep_config, master_config, sweep_overrides)
        return self._shared.of(words, compose)

    @cached_property
    def _shared(self) -> SharedCompositions:
        return SharedCompositions(self.repository)


def _write_out_homes(config: DictConfig) -> None:
    for path in PATHS:
        group, _, key = path.rpartition(".")
        node = OmegaConf.select(config, group) if group else config
        found = node._get_node(key) if isinstance(node, DictConfig) else None
        raw = found._value() if found is not None else None
        if isinstance(raw, str) and raw.startswith("~"):
            with read_write(node), open_dict(node):
                node[key] = home(raw)


def check(config: DictConfig) -> None:
    """Raise UserError for anything that Hydra would call from its own node outside estlab and the listed plugins."""
    plugins = config.get("plugins")
    listed = [name for name in plugins if isinstance(name, str)] if isinstance(plugins, ListConfig) else []
    if listed and str(Path.cwd()) not in sys.path:
        # An installed command, unlike python -m, does not look in the current folder.
        sys.path.insert(0, str(Path.cwd()))
    allowed = ("estlab", *listed)
    for path, key, value in _values(config.hydra, "hydra"):
        where = f"{path}.{key}"
        if key == "_target_":
            _check_target(where, value, allowed)
        elif path.startswith(("hydra.job_logging", "hydra.hydra_logging")):
            _check_logging(where, key, value, allowed)
    _check_callbacks(config.hydra.callbacks)


def _check_callbacks(callbacks: Any) -> None:
    for name in callbacks:
        with suppress(OmegaConfBaseException):
            if isinstance(callbacks[name], DictConfig) and isinstance(callbacks[name].get("_target_"), str):
                continue
        raise UserError(f"hydra.callbacks.{name} names no class; write +hydra.callbacks.{name}._target_=PACKAGE.CLASS")


def _values(node: Any, path: str) -> Iterator[tuple[str, str, Any]]:
    """Every value of a node with its path and key, as Hydra will use it; None for one that cannot be known yet."""
    keys = list(node) if isinstance(node, DictConfig) else range(len(node))
    for key in keys:
        try:
            value = node[key]
        except OmegaConfBaseException:
            value = None
        if isinstance(value, DictConfig | ListConfig):
            yield from _values(value, f"{path}.{key}")
        else:
            yield path, str(key), value


def _check_target(path: str, name: Any, allowed: tuple[str, ...]) -> None:
    if path in _PLUGINS and _PLUGIN.match(str(name)):
        return
    if path.startswith("hydra.callbacks.") and _HYDRAS_CALLBACK.fullmatch(str(name)):
        return
    found = located(str(name), path, allowed)
    if re.fullmatch(r"hydra\.callbacks\.[^.]+\._target_", path) and not _is_callback(found):
        raise UserError(
            f"{path} {name} is not a callback, which is a class with methods such as on_run_start and on_job_end"
        )


def _is_callback(found: Any) -> bool:
    return inspect.isclass(found) and any(name.startswith("on_") for name in dir(found))


def _check_logging(path: str, key: str, value: Any, allowed: tuple[str, ...]) -> None:
    if key in ("()", "class"):
        if not (_LOGGERS.fullmatch(str(value)) or value == _COLOURS):
            located(str(value), path, allowed)
    elif isinstance(value, str) and re.match(r"(ext|cfg)://", value) and value not in _STREAMS:
        raise UserError(f"{path} {value} is refused: a log goes to {' or '.join(_STREAMS)}, or to a file")
