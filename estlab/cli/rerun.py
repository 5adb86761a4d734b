"""estlab rerun: repeats a run from its own directory, and reports whether its figures are the same."""

import argparse
import hashlib
import re
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from estlab.cli.parser import Parser
from estlab.config.earlier import completed
from estlab.errors import UserError
from estlab.launch.launcher import FAILED, OK, complain
from estlab.launch.path_arguments import PATHS, home
from estlab.launch.quoting import unquoted

if TYPE_CHECKING:
    from estlab.comparison.reproducibility import Deviation
    from estlab.config.settings import Settings
    from estlab.launch.execute import Request
    from estlab.report.grids import Grid
    from estlab.rundir.finished import Finished

_KEYS = ("plugins", "data.path", "cores", "output", "hydra.run.dir")
_EQUAL = 1e-9
_LINES = 10


class RerunOptions(argparse.Namespace):
    """The options of the command line."""

    words: list[str]


def parser() -> Parser:
    """The command line of estlab rerun."""
    found = Parser(
        "rerun",
        "rerun DIR [plugins=[PACKAGE,...]] [data.path=PATH] [cores=N]\n"
        "                    [output=FOLDER | hydra.run.dir=FOLDER]",
        "Repeats the run in DIR from its config.yaml, with its seed, into a new\n"
        "directory, and compares every figure. DIR is untrusted input: classes come only\n"
        "from estlab and from the plugins that you type. Its own list of plugins and its\n"
        "output are ignored: the new run goes below runs/, or where you say.",
        "exit codes: 0 the figures are the same to 1e-9, 1 they are not, or the run\nfailed, 2 usage, 130 interrupted",
    )
    found.add_argument("words", metavar="DIR key=value", nargs="*", help="the run's directory, and keys to replace")
    return found


@dataclass(frozen=True)
class Rerun:
    """Which run to repeat, and what differs from it: where its data are, how it is computed, where it goes."""

    folder: Path
    plugins: list[str]
    data: str | None
    cores: int | None
    output: str
    to: str | None


def rerun(arguments: Sequence[str]) -> int:
    """Run again and compare. Returns the exit code."""
    wanted = _read(arguments)
    from estlab import rundir
    from estlab.comparison import reproducibility
    from estlab.launch.execute import execute
    from estlab.rundir import finished

    before = finished.read(_itself(wanted.folder))
    config, added = completed(_config(before, wanted), before.scenario, before.filter)
    request = _request(before, config, arguments)
    settings = _settings(before, request, wanted)
    if added:
        complain(
            f"note: {before.path} was made by an earlier estlab; these keys take their default values: "
            f"{', '.join(added)}"
        )
    if why := finished.unfinished(before.status):
        complain(f"note: there will be nothing to compare with: {before.path} has no complete result ({why})")
    directory = rundir.RunDirectory(_place(wanted, before), rerun_of=str(before.path.resolve()))
    directory.link_latest(Path(settings.output))

    def describe_changes(findings: object) -> None:
        directory.describe(changed=reproducibility.changes(before.facts, directory.facts()))

    code = execute(request, directory, settings, describe_changes)
    if finished.unfinished(finished.status(directory.path)):
        return code
    return FAILED if why else _compare(before, finished.read(directory.path))


def _read(arguments: Sequence[str]) -> Rerun:
    from estlab.config.build import nearest
    from estlab.rundir.finished import is_run

    keys: dict[str, str] = {}
    folders = []
    for word in parser().read(arguments, RerunOptions()).words:
        key, equals, value = word.partition("=")
        if not equals or Path(word).exists():
            folders.append(Path(word))
        elif key in _KEYS and not value:
            raise UserError(f"{word}: {key} needs a value; leave it out for none")
        elif key not in _KEYS:
            near = nearest(key, _KEYS)
            raise UserError(f"{word}: estlab rerun repeats a run; it only takes {', '.join(_KEYS)}{near}")
        else:
            keys[key] = home(unquoted(value)) if key in PATHS else value
    if len(folders) != 1:
        raise UserError("estlab rerun takes one run directory, for example estlab rerun runs/latest; see --help")
    if not is_run(folders[0]):
        raise UserError(f"{folders[0]}: not a run directory, because it has no status.json")
    plugins = keys.get("plugins", "[]")
    if not (match := re.fullmatch(r"\[([\w\s,]*)\]", plugins)):
        raise UserError(f"plugins={plugins}: write a list, for example plugins=[mine]")
    typed = [name.strip() for name in match[1].split(",") if name.strip()]
    output = keys.get("output", "runs")
    cores = int(keys["cores"]) if re.fullmatch("[1-9][0-9]{0,8}", keys.get("cores", "")) else None
    if cores is None and keys.get("cores", "null") != "null":
        raise UserError(f"cores={keys['cores']}: write an integer from 1, for example cores=1")
    return Rerun(folders[0], typed, keys.get("data.path"), cores, output, keys.get("hydra.run.dir"))


def _itself(folder: Path) -> Path:
    """The directory itself and not the link ``latest``, which the new run is about to move; relative if possible."""
    path = folder.resolve()
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


def _config(before: "Finished", wanted: Rerun) -> dict[str, Any]:
    """The configuration as it was, except for output, plugins, number of cores and the place of the data."""
    config = dict(before.config) | {"output": wanted.output, "plugins": wanted.plugins, "cores": wanted.cores}
    if config.get("engine") == "numba":  # how the steps were compiled earlier
        config["engine"] = "auto"
    data = config.get("data")
    if isinstance(data, Mapping) and data.get("source") == "files":
        config["data"] = dict(data) | {"path": _data_path(before, str(data.get("path")), wanted.data)}
    elif wanted.data:
        raise UserError(f"data.path={wanted.data} would not be read, because the run's data were simulated")
    return config


def _data_path(before: "Finished", was: str, typed: str | None) -> str:
    """Where the data are: as typed, as they were called, or where run.json has them; warns of changed files.

    Raises UserError for files that are gone.
    """
    files = [Path(file) for file in before.data]
    recorded = Path(was)
    for place in [p for file in files for p in (file, *file.parents)]:
        if place.parts[-len(recorded.parts) :] == recorded.parts:
            recorded = place
            break
    path = Path(typed) if typed else Path(was) if Path(was).exists() else recorded
    for file, digest in zip(files, before.data.values(), strict=True):
        here = path / (file.relative_to(recorded) if file.is_relative_to(recorded) else file.name)
        if not here.exists() and not file.is_relative_to(recorded):
            here = file  # of a folder of its own, by data.files
        if not here.is_file():
            raise UserError(f"{here}: the data file is gone; give its folder as data.path=FOLDER")
        with open(here, "rb") as stream:
            found = hashlib.file_digest(stream, "sha256").hexdigest()
        if found != digest:
            complain(f"warning: {here} has changed: SHA-256 {digest[:12]} before, {found[:12]} now")
    return str(path)


def _request(before: "Finished", config: dict[str, Any], arguments: Sequence[str]) -> "Request":
    """The request for the run with this configuration."""
    import yaml

    from estlab import rundir
    from estlab.config.settings import Names
    from estlab.launch.execute import Request
    from estlab.rundir import finished

    return Request(
        plain=config,
        names=Names(before.scenario, before.filter, before.changes),
        config=yaml.safe_dump(config, sort_keys=False, allow_unicode=True),
        overrides=finished.text(before.path, rundir.OVERRIDES),
        command=["estlab", "rerun", *arguments],
    )


def _settings(before: "Finished", request: "Request", wanted: Rerun) -> "Settings":
    """Its configuration as objects, limited to estlab's own classes and the plugins that were typed."""
    from estlab import rundir

    if wanted.plugins:
        sys.path.insert(0, str(Path.cwd()))
    try:
        return request.settings()
    except UserError as error:
        theirs = before.config.get("plugins")
        hint = f" (its own plugins, {theirs}, are ignored: type those that you trust)" if theirs else ""
        where = "" if str(error).startswith("plugins: ") else f"{before.path / rundir.CONFIG}: "  # those are typed
        raise UserError(f"{where}{error}{hint}") from error


def _place(wanted: Rerun, before: "Finished") -> Path:
    if wanted.to:
        return Path(wanted.to)
    stamp = time.strftime("%Y-%m-%d/%H-%M-%S") + f"-{time.time_ns() // 1000 % 1_000_000:06d}"
    name = f"{before.scenario}_{'-'.join(before.filters)}".replace("/", "-")
    return Path(wanted.output) / f"{stamp}_{name[:100]}"


def _compare(before: "Finished", now: "Finished") -> int:
    """Print whether the figures are the same, and what has changed. Returns the exit code."""
    from estlab.comparison import reproducibility
    from estlab.report import grids
    from estlab.report.console import print_line

    try:
        found = reproducibility.deviations(before.path, now.path)
    except UserError as error:
        return complain(f"the figures cannot be compared: {error}", FAILED)
    largest = found[0].relative if found else 0.0
    for bound, precision in ((0.0, "to the last bit"), (1e-12, "to 1e-12"), (_EQUAL, "to 1e-9")):
        if largest <= bound:
            print_line(f"the figures equal those of {before.path}: identical {precision}")
            break
    else:
        grids.show(_table(found))
    hashes = sorted(before.data.values()) != sorted(now.data.values())
    changed = [*reproducibility.changes(before.facts, now.facts), *(["data files, by their SHA-256"] if hashes else [])]
    print_line(
        f"changed: {'; '.join(changed)}" if changed else "nothing has changed: estlab, packages, machine, data, plugins"
    )
    if largest <= _EQUAL:
        return OK
    return complain(f"the figures differ from those of {before.path}", FAILED)


def _table(found: "Sequence[Deviation]") -> "Grid":
    from estlab.report.grids import Grid

    lines = [
        [one.file, one.what, _number(one.before), _number(one.now), f"{one.relative:.2g}"] for one in found[:_LINES]
    ]
    title = f"the largest of {len(found)} differences, relative to the column's largest value"
    return Grid(title, ["file", "what", "before", "now", "relative"], lines, 2)


def _number(value: float) -> str:
    return "" if value != value else f"{value:.10g}"
