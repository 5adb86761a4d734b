"""Writes the result of an experiment into a run directory: arrays and tables, then pictures."""

from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from typing import BinaryIO

import numpy as np

from estlab import rundir
from estlab.experiment.drawing import drawn
from estlab.experiment.result import Result
from estlab.report import csv_tables
from estlab.rundir import RunDirectory


def write(result: Result, directory: RunDirectory) -> None:
    """Write every file of a result. Anything that cannot be written is added to the missing parts, and loses nothing
    else.

    Raises OSError for a disk that cannot be written, WorkerLostError if a process that drew died.
    """
    attempts = result.attempts

    def put(name: str, write: Callable[[BinaryIO], object], needed: bool = False) -> None:
        attempts.put(name, partial(directory.write, name, write), needed)

    # The pictures take longest: another core starts with them while this one writes the tables.
    with drawn(result) if result.settings.plots else nullcontext(()) as pictures:
        put(rundir.ESTIMATES, lambda stream: np.savez(stream, allow_pickle=False, **result.arrays), needed=True)
        for file in result.tables:
            put(file, partial(_write_table, result, file), needed=file == rundir.METRICS)
        for name, content in pictures:
            put(name, partial(_write_bytes, content))


def _write_table(result: Result, file: str, stream: BinaryIO) -> None:
    csv_tables.write(result.table(file), stream)


def _write_bytes(content: bytes, stream: BinaryIO) -> None:
    stream.write(content)
