"""estlab.sweep: every combination of values, in a separate process; and the directory of a sweep as an object."""

import os
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from html import escape
from os import PathLike, fspath
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from estlab.api import tables
from estlab.api.comparing import compare
from estlab.api.finding import load
from estlab.api.run import Run
from estlab.api.words import words_of
from estlab.errors import EstlabError, UserError, printable
from estlab.rundir import finished
from estlab.rundir.layout import FAILURES, GROUPS, SWEEP, TABLE_BYTES

if TYPE_CHECKING:
    from pandas import DataFrame

_USAGE = 2  # exit code
_MOMENT = 1.0  # seconds


class Sweep(Mapping[str, Run]):
    """A sweep from its directory: its jobs' runs by name, in their order, and its tables.

    path: the directory, such as ``sweep.dir`` or the last line that ``estlab sweep`` prints. plugins: as for
    :func:`estlab.load`.

    Raises UserError for a directory that is not a sweep's.

    >>> import estlab
    >>> estlab.Sweep("nowhere")
    Traceback (most recent call last):
    estlab.errors.UserError: nowhere: not the directory of a finished sweep, because it has no sweep.csv
    """

    def __init__(self, path: str | PathLike[str], plugins: Sequence[str] = ()) -> None:
        self.path, self.plugins = Path(path), tuple(plugins)
        if not (self.path / SWEEP).is_file():
            raise UserError(f"{self.path}: not the directory of a finished sweep, because it has no {SWEEP}")

    @cached_property
    def table(self) -> "DataFrame":
        """A row for each job and filter: job, the keys with several values, filter, status, wall_time_s and metrics.

        ``rmse.x`` and so on are numbers, with ``.low`` and ``.high`` of their intervals; a swept key is a number if all
        of its values are.
        """
        return _table(self.path, SWEEP)

    @cached_property
    def groups(self) -> "DataFrame":
        """With ``sweep.repeats``, a row for each combination: the mean of each metric over its repeats."""
        return _table(self.path, GROUPS)

    @cached_property
    def failures(self) -> "DataFrame":
        """A row for each attempt at a job that failed, with the reason."""
        return _table(self.path, FAILURES)

    def compare(self, metrics: Sequence[str] = (), against: int | str = 1) -> "DataFrame":
        """All jobs side by side; see :func:`estlab.compare`."""
        return compare(self.path, metrics=metrics, against=against)

    def __getitem__(self, job: str) -> Run:
        """The run of a job by its name. Raises KeyError for an unknown job."""
        if job not in self._jobs:
            raise KeyError(job)
        return load(self.path / job, self.plugins)

    def __iter__(self) -> Iterator[str]:
        return iter(self._jobs)

    def __len__(self) -> int:
        return len(self._jobs)

    def __repr__(self) -> str:
        counts = self.table.drop_duplicates("job")["status"].value_counts().to_dict()
        shown = ", ".join(f"{count} {word}" for word, count in counts.items())
        return printable(f"Sweep({len(self)} jobs: {shown}; {self.path})")

    def _repr_html_(self) -> str:
        return f"<p>{escape(repr(self))}</p>{self.table.to_html(notebook=True)}"

    @cached_property
    def _jobs(self) -> list[str]:
        return list(dict.fromkeys(self.table["job"]))


def sweep(*words: str, progress: bool = False, config_dir: str | PathLike[str] | None = None, **keys: Any) -> Sweep:
    """Run every combination of values, as ``estlab sweep`` does, and return the sweep.

    words: as you type them there: "filter=ekf,ukf", "noise.filter.process_scale=0.5,1,2", "sweep.repeats=3",
    "hydra/sweeper=optuna", "hydra/launcher=joblib". keys: for all jobs, as for :func:`estlab.run`.
    progress: True shows the command line's live line on standard error.

    It runs in a separate process, which also has the folders of ``sys.path``. An interruption ends it in order, and
    ``estlab sweep --resume`` continues. Some jobs may fail: :attr:`Sweep.failures` says why.

    Raises UserError if no job could start, EstlabError if none succeeded.

    >>> import estlab
    >>> found = estlab.sweep("filter=ekf,ukf", scenario="landmark", runs=3, steps=20)
    >>> found.table[["job", "filter", "status"]]
                  job filter status
    0  0_landmark_ekf    ekf     ok
    1  1_landmark_ukf    ukf     ok
    >>> found["1_landmark_ukf"].filters
    ('ukf',)
    """
    folder = [f"--config-dir={fspath(config_dir)}"] if config_dir is not None else []
    command = [sys.executable, "-m", "estlab", "sweep", *folder, *words_of(words, keys)]
    code, output, errors = _finished(command, progress)
    place = Path(output[-1]) if output else Path()
    if output and (place / SWEEP).is_file():
        return Sweep(place)
    message = errors[-1].removeprefix("estlab: ") if errors else f"the sweep ended with exit code {code}"
    raise UserError(message) if code == _USAGE else EstlabError(message)


def _finished(command: Sequence[str], progress: bool) -> tuple[int, list[str], list[str]]:
    """The exit code of a command, and the lines that it wrote to standard output and standard error."""
    paths = [path or os.getcwd() for path in sys.path]  # noqa: PTH109 - as text, like the others
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths), "PYTHONUNBUFFERED": "1"}
    errors: list[str] = []
    with subprocess.Popen(
        command,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="utf-8",
        errors="replace",
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        hearing = threading.Thread(target=_hear, args=(process.stderr, errors, progress), daemon=True)
        hearing.start()
        try:
            output = process.stdout.read()
        except KeyboardInterrupt:
            _interrupt(process)
            raise
        hearing.join()
    return process.returncode, output.splitlines(), errors


def _hear(stream: IO[str], lines: list[str], shown: bool) -> None:
    """Collect the lines of a stream, and show them on standard error as they arrive if requested."""
    for line in stream:
        lines.append(line.rstrip("\n"))
        if shown:
            print(lines[-1], file=sys.stderr)


def _interrupt(process: "subprocess.Popen[str]") -> None:
    """End a sweep in order. A sweep on the same terminal already received the interruption; a second would kill it."""
    try:
        process.wait(_MOMENT)
    except subprocess.TimeoutExpired:
        process.terminate()
        process.wait()


def _table(folder: Path, file: str) -> "DataFrame":
    """A table of a sweep, with numeric columns as numbers; empty if there is none."""
    if not (folder / file).is_file():
        return tables.of_text("job\n")
    return tables.of_text(finished.text(folder, file, TABLE_BYTES))
