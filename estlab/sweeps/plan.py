"""From keys with several values to the combinations of a sweep."""

import math
from collections.abc import Mapping, Sequence
from itertools import product

from estlab.errors import UserError

MOST = 1_000_000  # jobs of a sweep at most

Values = Mapping[str, Sequence[str]]


def combinations(swept: Values, zipped: Sequence[str]) -> list[dict[str, str]]:
    """Every combination of the keys' values, the last key varying fastest; zipped keys vary together.

    Raises UserError for zipped keys that are not swept or have unequal numbers of values, and for more than MOST.
    """
    _check_zip(swept, zipped)
    together = {key: values for key, values in swept.items() if key in zipped}
    pairs = [dict(zip(together, row, strict=True)) for row in zip(*together.values(), strict=True)]
    axes, placed = [], False
    for key, values in swept.items():
        if key not in together:
            axes.append([{key: value} for value in values])
        elif not placed:
            axes.append(pairs)
            placed = True
    if math.prod(map(len, axes)) > MOST:
        raise UserError(f"a sweep has at most {MOST} jobs; leave out values, or sweep keys one after another")
    found = [{key: value for part in parts for key, value in part.items()} for parts in product(*axes)]
    return [{key: values[key] for key in swept} for values in found]


def _check_zip(swept: Values, zipped: Sequence[str]) -> None:
    from estlab.config.build import nearest

    for key in zipped:
        if key not in swept:
            raise UserError(f"sweep.zip: {key} has no list of values in this sweep{nearest(key, list(swept))}")
    if len(zipped) == 1 or len(set(zipped)) != len(zipped):
        raise UserError(f"sweep.zip must name two keys or more, each once, got [{','.join(zipped)}]")
    lengths = {key: len(swept[key]) for key in zipped}
    if len(set(lengths.values())) > 1:
        lengths_of_all = ", ".join(f"{key} has {length}" for key, length in lengths.items())
        raise UserError(f"sweep.zip pairs values, so the keys need equally many: {lengths_of_all}")
