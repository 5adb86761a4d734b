"""From the command line to a command."""

import argparse
import gc
import os
import re
import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from estlab import __version__
from estlab.cli.parser import CONFIG_FOLDER, Parser
from estlab.cli.stdio import StandardStreams
from estlab.config.locations import options
from estlab.errors import NO_MEMORY, UserError, is_lack_of_memory, printable
from estlab.launch.arguments import CONFIG_DIR
from estlab.launch.commands import run_job, simulate_job
from estlab.launch.launcher import FAILED, INTERRUPTED, OK, complain, launch
from estlab.parallel.cores import enough_memory, one_thread_each
from estlab.parallel.signals import interruptible
from estlab.python_warnings import in_a_line

_EXAMPLES = """\
commands:
  estlab run scenario=car filter=ukf
      run a filter on a problem, into a timestamped directory under runs/
  estlab run filter=[ekf,ukf]
      several filters on the same truth and readings
  estlab sweep filter=ekf,ukf runs=50
      every combination of the values given (the same as run -m)
  estlab sweep ... --dry-run
      list its jobs without running them
  estlab sweep --resume DIR
      run what is left of a sweep that was stopped
  estlab verify
      run every experiment that states its answer, and check the answer
  estlab compare DIR [DIR ...]
      compare runs: intervals, paired tests; --csv, --md, --latex, --plot
  estlab rerun DIR
      repeat a run from its own directory: are the figures the same?
  estlab clean
      list the runs that failed or stopped; delete them with --yes
  estlab simulate scenario=car data.path=DIR
      write simulated data in the problem's original file layout
  estlab report DIR [DIR ...]
      draw report.html of a run or a sweep again, from its directory alone
  estlab list [scenarios|filters|experiments]
      list what is available; with --config-dir DIR, also what is there
  estlab run --help
      every key of the configuration, and Hydra's own flags
  estlab run -sc install=bash
      shell completion: eval "$(estlab run -sc install=bash)"

exit codes: 0 ok, 1 a run failed or missed an expectation,
2 usage or configuration, 3 some jobs of a sweep failed, 130 interrupted
"""

_MODULES = ("verify", "compare", "report", "rerun", "clean")  # of these names, with a function of the name and a parser
_ALIVE = 100_000  # more objects, after which Python looks for dead ones
_HEAD = 4000  # characters of a file within which its comment must end
_GROUPS = {"scenarios": "scenario", "filters": "filter", "experiments": "experiment"}


def command() -> int:
    """The command line of a process that runs nothing else. Returns its exit code.

    Python looks for cycles of dead objects each time that 700 objects more are alive, and again in all modules before
    it ends: a fifth of a short run's time.
    """
    gc.set_threshold(_ALIVE)
    try:
        return main()
    finally:
        gc.freeze()


def main(arguments: list[str] | None = None) -> int:
    """Run a command line. Returns its exit code."""
    streams = StandardStreams()
    code = _run(sys.argv[1:] if arguments is None else arguments)
    if why := streams.failure():
        return complain(f"standard output: {why}; not all of it was written", code or FAILED)
    return code


def _run(arguments: list[str]) -> int:
    one_thread_each()
    interruptible()
    try:
        if {*arguments[:1]} & {*_COMMANDS} - {"list"}:
            enough_memory(f"estlab {arguments[0]}")
        with in_a_line(complain):
            return _dispatch(arguments)
    except UserError as error:
        return complain(str(error))
    except KeyboardInterrupt:
        print("estlab: interrupted", file=sys.stderr)
        # If the signal came while Python executed a text, such as a dataclass being defined, Python considers it
        # unhandled until the next text, and python -m would end by the signal instead of with the exit code.
        exec("")
        return INTERRUPTED
    except OSError as error:
        if error.strerror is None:
            raise  # not the system's but Hydra's, for users who want its traceback
        return complain(f"{error.filename or 'standard output'}: {error.strerror}", FAILED)
    except (MemoryError, ImportError) as error:
        if not is_lack_of_memory(error):
            raise
        return complain(NO_MEMORY, FAILED)


def _dispatch(arguments: list[str]) -> int:
    command, rest = (arguments[0], arguments[1:]) if arguments else ("--help", [])
    if command in ("-sc", "--shell-completion"):
        return _complete(rest)
    try:
        return _COMMANDS[command](rest) if command in _COMMANDS else _other(command)
    except SystemExit as done:  # what argparse ends by once it has shown a help
        return int(done.code or OK)


def _other(command: str) -> int:
    """estlab's own flags; raises UserError for an unknown command."""
    parser = Parser("", "COMMAND ...", "A command-line laboratory for nonlinear state estimation.", _EXAMPLES)
    parser.add_argument("--version", action="version", version=f"estlab {__version__}", help="show the version")
    if command == "help" or command.startswith("-"):
        parser.read(["--help" if command == "help" else command], argparse.Namespace())
    from estlab.config.build import nearest

    raise UserError(f"unknown command {command}{nearest(command, list(_COMMANDS))} (see estlab --help)")


def _run_or_sweep(command: str, rest: list[str]) -> int:
    typed = ["estlab", command, *rest]
    if command == "sweep" or {"-m", "--multirun"} & set(rest):
        from estlab.sweeps.resume import without_own_flags

        rest = without_own_flags(rest)
    return launch([*(["--multirun"] if command == "sweep" else []), *rest], partial(run_job, typed))


def _simulate(rest: list[str]) -> int:
    if {"-m", "--multirun"} & set(rest):
        raise UserError("estlab simulate writes one data set; leave out --multirun")
    # It makes no run directory, so Hydra's is the current folder.
    return launch(["hydra.run.dir=.", *rest], simulate_job)


def _of_module(command: str, rest: list[str]) -> int:
    """A command in the module of its name, imported when it is called."""
    return int(getattr(_module(command), command)(rest))


def _module(command: str) -> Any:
    return import_module(f"estlab.cli.{command}")


class ListOptions(argparse.Namespace):
    """The options of estlab list."""

    kinds: list[str]
    config_dir: list[Path]


def _list_parser() -> Parser:
    found = Parser(
        "list",
        "list [scenarios] [filters] [experiments] [--config-dir DIR]",
        "Lists what is available, each with a line that describes it.",
    )
    found.add_argument("kinds", metavar="KIND", nargs="*", help=f"{', '.join(_GROUPS)}; all if you name none")
    own = "a folder of your own configuration, to list its content too"
    found.add_argument(*CONFIG_DIR, type=CONFIG_FOLDER, action="append", default=[], metavar="DIR", help=own)
    return found


def _list(arguments: list[str]) -> int:
    """Print the options of each group, including the user's own, with the comment that heads each file."""
    wanted = _list_parser().read(arguments, ListOptions())
    for kind in wanted.kinds:
        if kind not in _GROUPS:
            from estlab.config.build import nearest

            raise UserError(f"estlab list takes {', '.join(_GROUPS)}; got {kind}{nearest(kind, list(_GROUPS))}")
    for kind in wanted.kinds or _GROUPS:
        print(kind if not wanted.kinds else "", end="\n" if not wanted.kinds else "")
        found = options(_GROUPS[kind], wanted.config_dir)
        width = max(map(len, found))
        for name, path in found.items():
            lines = _comment(path)
            print(printable(f"  {name:{width}}  {lines[0]}"))
            for line in lines[1:]:
                print(printable(f"  {'':{width}}  {line}"))
    return OK


def _comment(path: Path) -> list[str]:
    """The lines of the comment that heads a file."""
    lines = []
    with open(path, encoding="utf-8", errors="replace") as stream:
        head = stream.read(_HEAD)
    for line in head.splitlines():
        if not line.startswith("#"):
            break
        if not line.startswith("# @package"):
            lines.append(line.lstrip("# "))
    return lines or [""]


def _complete(arguments: list[str]) -> int:
    """Complete a command line for the shell: our own words, then Hydra's as if there were no subcommand."""
    line = os.environ.get("COMP_LINE", "")
    words = line.split()
    at_second = len(words) < 2 or (len(words) == 2 and not line.endswith(" "))
    if not any(argument.startswith("query=") for argument in arguments):
        return launch(["-sc", *arguments], simulate_job)
    if at_second:
        print(" ".join(w for w in _COMMANDS if w.startswith(words[1] if len(words) > 1 else "")))
        return OK
    begun = "" if line.endswith(" ") else words[-1]
    if begun.startswith("-") and words[1] in (*_MODULES, "list"):
        parser = _list_parser() if words[1] == "list" else _module(words[1]).parser()
        print(" ".join(flag for flag in parser.flags() if flag.startswith(begun)))
        return OK
    if words[1] == "list":
        print(" ".join(_GROUPS))
        return OK
    if words[1] in ("compare", "rerun", "clean"):
        return OK  # the shell continues with files and folders
    if words[1] == "report":
        from estlab.cli.report import folders

        print(printable(" ".join(folders(begun))))
        return OK
    if words[1] == "verify":
        from estlab.cli.verify import experiment_files

        print(" ".join(name for name in experiment_files(None) if name.startswith(begun)))
        line = " ".join([*words[:2], *(word for word in words[2:] if "=" in word and word != begun), begun])
    os.environ["COMP_LINE"] = re.sub(r"^(\s*\S+\s+)\S+\s", r"\1", line, count=1)
    return launch(["-sc", *arguments], simulate_job)


_COMMANDS: dict[str, Callable[[list[str]], int]] = {
    "run": partial(_run_or_sweep, "run"),
    "sweep": partial(_run_or_sweep, "sweep"),
    **{command: partial(_of_module, command) for command in _MODULES},
    "simulate": _simulate,
    "list": _list,
}
