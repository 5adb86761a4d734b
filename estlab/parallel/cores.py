"""How many cores a job may use, and how its processes stay within them: threads of linear algebra, memory."""

import contextlib
import math
import os
import resource
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from estlab.errors import UserError

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
_THREADS_OF_OPENBLAS = "scipy_openblas_{}_num_threads64_", "openblas_{}_num_threads64_", "openblas_{}_num_threads"
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # malloc.h
_MOST_MAPPED = 32 * 2**20  # the most that glibc takes
# MB of address space as measured: 299 for a run, 419 for a sweep, whose pictures need pandas, and 463; plus a margin
_COMPILED = "engine=compiled"
_ADDRESSES = {"estlab": 320, "estlab sweep": 440, _COMPILED: 500}
_QUOTA = Path("/sys/fs/cgroup/cpu.max"), Path("/sys/fs/cgroup/cpu/cpu.cfs_quota_us")
_PERIOD = Path("/sys/fs/cgroup/cpu/cpu.cfs_period_us")


def processes(cores: int | None, tasks: int) -> int:
    """How many processes share so many tasks of a job, this one included. cores: the number asked for, None for all.

    One if no process can be started, or if this process belongs to a pool that already uses the cores.
    """
    import multiprocessing

    pooled = multiprocessing.parent_process() is not None
    if multiprocessing.current_process().daemon or (cores is None and pooled):
        return 1
    return max(1, min(cores or usable(), tasks))


def usable() -> int:
    """The processors that this process may use: its affinity, limited by its container's share of time."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(count, _quota() or count))


def one_thread_each() -> None:
    """Limit linear algebra to one thread, before NumPy is imported, unless the user sets the number of threads.

    The matrices here are small. A process with one thread can be forked, and does not compete with its siblings for a
    core.
    """
    if "numpy" not in sys.modules and not _user_says():
        os.environ.update(dict.fromkeys(_THREADS, "1"))


@contextlib.contextmanager
def one_thread_meanwhile() -> Iterator[None]:
    """The same for the body alone, once NumPy is imported: of its OpenBLAS; any other library is left as it is."""
    count, set_count = (int, id) if _user_says() else _openblas()
    before = count()
    set_count(1)
    try:
        yield
    finally:
        set_count(before)


def _user_says() -> bool:
    """Whether the user says how many threads linear algebra has."""
    return any(name in os.environ for name in _THREADS)


def _openblas() -> tuple[Callable[[], int], Callable[[int], object]]:
    """What gives and what sets the number of its threads; for another library nothing does."""
    import ctypes

    from numpy.linalg import _umath_linalg

    library = ctypes.CDLL(_umath_linalg.__file__)  # it finds the names of what it is linked with, too
    for name in _THREADS_OF_OPENBLAS:
        with contextlib.suppress(AttributeError):
            return getattr(library, name.format("get")), getattr(library, name.format("set"))
    return int, lambda count: None


def enough_memory(what: str) -> None:
    """Raise UserError if this process may use less memory than ``what`` needs to be imported.

    The libraries that hit such a limit during their import hang, crash or abort.
    """
    needed = _ADDRESSES.get(what, _ADDRESSES["estlab"])
    most, _ = resource.getrlimit(resource.RLIMIT_AS)
    if most != resource.RLIM_INFINITY and most < needed * 2**20:
        raise UserError(
            f"out of memory: {what} needs {needed} MB of address space and this process may use "
            f"{most // 2**20}; {'set engine=numpy, or ' if what == _COMPILED else ''}raise its limit, for "
            "example ulimit -v unlimited"
        )


def keep_memory() -> None:
    """Keep the memory that arrays return, instead of giving each large one back to the system and asking for fresh
    pages.

    Configures glibc's allocator, if it is used; fresh pages cost a tenth of a block's time.
    """
    _tell_allocator(2**30)


@contextlib.contextmanager
def memory_given_back() -> Iterator[None]:
    """After the body, which may keep memory, what is free goes back to the system, and from then on as usual."""
    try:
        yield
    finally:
        import ctypes

        _tell_allocator(2 * _MOST_MAPPED)
        with contextlib.suppress(AttributeError, OSError):
            ctypes.CDLL(None).malloc_trim(0)


def _tell_allocator(kept: int) -> None:
    """How many free bytes it keeps, among arrays of all sizes, as glibc ends up doing of its own accord."""
    import ctypes

    with contextlib.suppress(AttributeError, OSError):
        tell = ctypes.CDLL(None).mallopt
        tell(_MMAP_THRESHOLD, _MOST_MAPPED)
        tell(_TRIM_THRESHOLD, kept)


def _quota() -> int | None:
    """The processor time that the container grants, in processors, from its control group; None for no limit."""
    for file in _QUOTA:
        with contextlib.suppress(OSError, ValueError, ZeroDivisionError):
            words = file.read_text().split()
            period = words[1] if len(words) > 1 else _PERIOD.read_text()
            share = float(words[0]) / float(period)  # without a limit, version 1 has -1 and version 2 a word
            return math.ceil(share) if share > 0.0 else None
    return None
