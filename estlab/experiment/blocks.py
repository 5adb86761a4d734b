"""Divides the runs of an ensemble into blocks: by the configuration alone, so the same on every machine."""

from estlab.config.settings import Settings

# Measured for filters of one point to 25: 500 runs fill the second-level cache; with fewer than 100, calls of NumPy
# cost more than their arithmetic. A particle filter's run counts as many points as it has particles.
_MOST, _LEAST = 500, 100
_MOST_POINTS, _LEAST_POINTS = 2_000_000, 10_000


def block_count(settings: Settings) -> int:
    """The number of blocks, at least one."""
    first, size = _sizes(settings)
    return 1 + max(0, -(-(len(settings.run_numbers) - first) // size))


def block(settings: Settings, number: int) -> range:
    """The run numbers of a block. The first holds all runs that are kept, so that these do not depend on the size."""
    first, size = _sizes(settings)
    runs = settings.run_numbers
    begin = runs.start + (first + (number - 1) * size if number else 0)
    return range(begin, min(begin + (size if number else first), runs.stop))


def _sizes(settings: Settings) -> tuple[int, int]:
    """The number of runs in the first block and in each of the others."""
    size = settings.block_runs or _even(settings)
    return max(size, settings.keep_runs), size


def _even(settings: Settings) -> int:
    """The runs of a block if blocks have equal size and an even number, so that two cores end together."""
    runs = len(settings.run_numbers)
    points = max(filter.traits.points for filter in settings.filters.values())
    most, least = (max(2, min(limit)) for limit in ((_MOST, _MOST_POINTS // points), (_LEAST, _LEAST_POINTS // points)))
    count = -(-runs // most)
    count = max(1, min(count + count % 2, runs // least))
    return -(-runs // count)
