"""The meaning of each colour in the pictures, and one colour for each filter, the same in all of them."""

from collections.abc import Collection, Iterable, Sequence
from itertools import chain, product
from zlib import crc32

from estlab.record import SMOOTHED

TRUTH, BAND, ENSEMBLE = "black", "C3", "C2"  # no filter has one of these

_FILTERS = {
    "ekf": "#1f77b4",
    "ukf": "#ff7f0e",
    "pf": "#9467bd",
    "ckf": "#17becf",
    "enkf": "#8c564b",
    "ghkf": "#e377c2",
    "iekf": "#bcbd22",
    "dead_reckoning": "#7f7f7f",
    "second_order": "#1b3a73",
    "srukf": "#b0740a",
    "srckf": "#0b6b75",
    "apf": "#5c2a9d",
    "rpf": "#c9a5f0",
}
_FREE = tuple(_FILTERS.values())
_DASHES = ("-", "--", ":")
MOST = len(_FREE) * len(_DASHES)  # curves that can be told apart


def colours(filters: Iterable[str]) -> dict[str, str]:
    """The colour of each filter of a run: a shipped filter's own; a plugin's by its name, or the next free one.

    Smoothed estimates have a darker shade of their filter's.
    """
    found: dict[str, str] = {}
    names = list(dict.fromkeys(filters))
    # A plugin's filter comes after those that have a colour, so that it takes none of theirs.
    for name in sorted((name.removesuffix(SMOOTHED) for name in names), key=lambda name: name not in _FILTERS):
        if name not in found:
            found[name] = _FILTERS.get(name) or _free(name, found.values())
    return {name: found.get(name) or _darker(found[name.removesuffix(SMOOTHED)]) for name in names}


def _free(name: str, taken: Collection[str]) -> str:
    """A colour that depends only on the name, unless it is taken."""
    first = crc32(name.encode()) % len(_FREE)
    order = [*_FREE[first:], *_FREE[:first]]
    return next((one for one in order if one not in taken), order[0])


def curves(filters: Sequence[str]) -> list[tuple[str, str]]:
    """Colour and dash of curves of these filters, no two alike up to MOST.

    A filter's curves have its colour with one dash after another, then the colours of absent filters.
    """
    own = colours(filters)
    others = [one for one in _FREE if one not in own.values()]
    found: list[tuple[str, str]] = []
    for name in filters:
        choices = chain(product([own[name]], _DASHES), product([*others, *own.values()], _DASHES))
        found.append(next((one for one in choices if one not in found), (own[name], _DASHES[0])))
    return found


def _darker(colour: str) -> str:
    """Half as bright."""
    return "#" + "".join(f"{int(colour[i : i + 2], 16) // 2:02x}" for i in (1, 3, 5))
