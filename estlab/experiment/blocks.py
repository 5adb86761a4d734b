"""How the runs of an ensemble are cut into blocks: by the configuration alone, so that every machine cuts alike."""

from estlab.config.build import Settings

# Measured for filters of one point to 25: 500 runs fill the second-level cache; of less than 100, calls of NumPy cost
# more than their arithmetic. A particle filter's run is as many points as it has particles.
_MOST, _LEAST = 500, 100
_MOST_POINTS, _LEAST_POINTS = 2_000_000, 10_000


def block_count(settings: Settings) -> int:
    """How many blocks there are, at least one."""
    first, size = _sizes(settings)
    return 1 + max(0, -(-(len(settings.run_numbers) - first) // size))


def block(settings: Settings, number: int) -> range:
    """The run numbers of a block. The first holds all that are kept, so that these do not depend on the size."""
    first, size = _sizes(settings)
    runs = settings.run_numbers
    begin = runs.start + (first + (number - 1) * size if number else 0)
    return range(begin, min(begin + (size if number else first), runs.stop))


def _sizes(settings: Settings) -> tuple[int, int]:
    """Runs in the first block and in each of the others."""
    size = settings.block_runs or _even(settings)
    return max(size, settings.keep_runs), size


def _even(settings: Settings) -> int:
    """The runs of a block where blocks are of one size and even in number, for two cores to end together."""
    runs = len(settings.run_numbers)
    points = max(filter.traits.points for filter in (settings.filters or {"": settings.filter}).values())
    most, least = (max(2, min(limit)) for limit in ((_MOST, _MOST_POINTS // points), (_LEAST, _LEAST_POINTS // points)))
    count = -(-runs // most)
    count = max(1, min(count + count % 2, runs // least))
    return -(-runs // count)
