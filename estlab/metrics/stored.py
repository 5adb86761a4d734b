"""Totals of runs as plain arrays, to store in a file and add elsewhere. They are only data: nothing is executed."""

from collections.abc import Iterator, Mapping

import numpy as np

from estlab.maths.space import Array
from estlab.metrics.moments import Histogram, SampleMoments
from estlab.metrics.paired import Comparison
from estlab.metrics.tally import CAUSES, Tally

_PAIR = "|"  # between the names of two filters; no name contains it


def tally_arrays(tally: Tally) -> Iterator[tuple[str, Array]]:
    """The sums, by name."""
    yield "runs", np.array([tally.runs, tally.sampled, tally.gated])
    yield "first_whitened", tally.first_whitened
    yield "first_error", tally.first[0]
    yield "first_nees", tally.first[1]
    for cause in CAUSES:
        yield f"diverged/{cause}", np.array([tally.diverged[cause], *tally.diverged_first[cause]])
    for name, array in tally.sums.items():
        yield f"sums/{name}", array
    for name, moments in tally.moments.items():
        yield from _moments_arrays(f"moments/{name}", moments)
    for name, histogram in tally.histograms.items():
        yield f"histograms/{name}", histogram.counts


def tally_of(empty: Tally, arrays: Mapping[str, Array]) -> Tally:
    """An empty tally filled with these arrays. Raises KeyError for one that is missing."""
    runs, sampled, gated = arrays["runs"]
    empty.runs, empty.sampled, empty.gated = int(runs), bool(sampled), bool(gated)
    empty.first_whitened = arrays["first_whitened"]
    empty.first = arrays["first_error"], arrays["first_nees"]
    for cause in CAUSES:
        count, *first = (int(number) for number in arrays[f"diverged/{cause}"])
        empty.diverged[cause], empty.diverged_first[cause] = count, first
    empty.sums = below(arrays, "sums")
    empty.moments = _moments_of(below(arrays, "moments"))
    for name, counts in below(arrays, "histograms").items():
        empty.histograms[name] = Histogram(counts.shape[:-1])
        empty.histograms[name].counts = counts
    return empty


def comparison_arrays(comparison: Comparison) -> Iterator[tuple[str, Array]]:
    """The sums, by name."""
    for (a, b), moments in comparison.moments.items():
        yield from _moments_arrays(f"moments/{a}{_PAIR}{b}", moments)
        yield f"wins/{a}{_PAIR}{b}", comparison.wins[a, b]
        yield f"met/{a}{_PAIR}{b}", comparison.met[a, b]


def comparison_of(empty: Comparison, arrays: Mapping[str, Array]) -> Comparison:
    """An empty comparison filled with these arrays."""
    for pair, moments in _moments_of(below(arrays, "moments")).items():
        a, b = pair.split(_PAIR)
        empty.moments[a, b] = moments
        empty.wins[a, b], empty.met[a, b] = arrays[f"wins/{pair}"], arrays[f"met/{pair}"]
    return empty


def below(arrays: Mapping[str, Array], prefix: str) -> dict[str, Array]:
    """The arrays whose names begin with a prefix, without it."""
    start = f"{prefix}/"
    return {name.removeprefix(start): array for name, array in arrays.items() if name.startswith(start)}


def _moments_arrays(name: str, moments: SampleMoments) -> Iterator[tuple[str, Array]]:
    yield f"{name}/count", moments.count
    yield f"{name}/mean", moments.mean
    yield f"{name}/scatter", moments.scatter


def _moments_of(arrays: Mapping[str, Array]) -> dict[str, SampleMoments]:
    names = dict.fromkeys(name.rpartition("/")[0] for name in arrays)
    return {n: SampleMoments(arrays[f"{n}/count"], arrays[f"{n}/mean"], arrays[f"{n}/scatter"]) for n in names}
