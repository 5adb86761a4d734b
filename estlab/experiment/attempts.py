"""Everything made after the filters, each thing separately: one that fails is missing, and loses no other."""

import logging
from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

import numpy as np

from estlab.errors import IncompleteError, plugin_fault, printable

Made = TypeVar("Made")

# Results of diverged runs are NaN or infinite, and they are counted: no arithmetic here is worth a warning.
_quietly = partial(np.errstate, invalid="ignore", over="ignore", divide="ignore")
_LONGEST = 200  # characters of a reason

log = logging.getLogger("estlab")


class Attempts:
    """The only place that draws, bounds, tests and writes for a run.

    missing: why each missing thing could not be made. Its traceback is logged.
    """

    def __init__(self, plugins: Sequence[str] = ()) -> None:
        self._plugins = plugins
        self._needed: list[str] = []
        self.missing: dict[str, str] = {}

    def made(self, what: str, make: Callable[[], Made], needed: bool = False) -> Made | None:
        """The result of ``make``; None if it raises. needed: whether a run without it is incomplete."""
        try:
            with _quietly():
                return make()
        except Warning:
            raise  # a user who turns warnings into errors wants to see them
        except (Exception, SystemExit) as error:
            self._miss(what, error, needed)
            return None

    def put(self, what: str, put: Callable[[], object], needed: bool = False) -> None:
        """Print or write something. Raises OSError: a terminal or disk that fails, fails for everything."""
        try:
            with _quietly():
                put()
        except Warning:
            raise
        except (Exception, SystemExit) as error:
            if isinstance(error, OSError) and not plugin_fault(error, self._plugins):
                raise
            self._miss(what, error, needed)

    def remarks(self) -> list[str]:
        """One line per reason, with everything that is missing because of it."""
        reasons: dict[str, list[str]] = {}
        for what, why in self.missing.items():
            reasons.setdefault(why, []).append(what)
        return [f"missing: {', '.join(what)} ({why}); the traceback is in log.txt" for why, what in reasons.items()]

    def complete(self, where: object) -> None:
        """Raise IncompleteError if something is missing that a run needs. where: the directory with the rest."""
        if self._needed:
            what = self._needed[0]
            more = f" and {len(self._needed) - 1} more" if len(self._needed) > 1 else ""
            raise IncompleteError(
                f"the run is incomplete, {what}{more} is missing ({self.missing[what]}); everything else is in "
                f"{where}, and the traceback in its log.txt"
            )

    def _miss(self, what: str, error: BaseException, needed: bool) -> None:
        self.missing[what] = printable(plugin_fault(error, self._plugins)) or _reason(error)
        self._needed += [what] if needed else []
        log.warning("missing: %s (%s)", what, self.missing[what], exc_info=error)


def _reason(error: BaseException) -> str:
    text = printable(" ".join(str(error).split()))
    text = text if len(text) <= _LONGEST else f"{text[:_LONGEST]} …"
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
