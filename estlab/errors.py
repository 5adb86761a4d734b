"""How a user is told no."""

import errno
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple


class EstlabError(Exception):
    """What estlab raises where it says what is wrong. The message is one line."""


class UserError(EstlabError):
    """A mistake that the user can mend. The message is one line: what is wrong, where, and the remedy."""


class AnswerError(UserError):
    """A user's model, record or filter that does not answer as its contract says."""


class WorkerLostError(EstlabError):
    """A process that shared the work ended before it was done. The message is one line, with the remedy."""


class IncompleteError(EstlabError):
    """Something that a run needs could not be computed. The message is one line, and says what is kept."""


class PluginError(EstlabError):
    """An exception of the user's own code. The message is one line: where it was raised, and what it says."""


class Frame(NamedTuple):
    """Where an exception passed through."""

    module: str
    function: str
    line: int


def frames(error: BaseException) -> list[Frame]:
    """The way of an exception, outermost first; that in the worker process it came from is its last part."""
    here = [
        Frame(str(frame.f_globals.get("__name__")), frame.f_code.co_qualname, line)
        for frame, line in traceback.walk_tb(error.__traceback__)
    ]
    return here + getattr(error, "frames_in_worker", [])


def plugin_fault(error: BaseException, plugins: Sequence[str]) -> str:
    """Where a plugin's code raised an exception and what it says, in one line; nothing if it is not one's.

    It is a plugin's if it passed through one: what a plugin calls it answers for. Errors that are a line already are
    nobody's.
    """
    if isinstance(error, (UserError, WorkerLostError, IncompleteError, PluginError, Warning)) or is_lack_of_memory(
        error
    ):
        return ""
    theirs = [frame for frame in frames(error) if frame.module.partition(".")[0] in plugins]
    if not theirs:
        return ""
    said = " ".join(str(error).split())
    where = f"{theirs[-1].module}.{theirs[-1].function}, line {theirs[-1].line}"
    return f"{where}, raised {type(error).__name__}" + (f": {said}" if said else "")


@contextmanager
def plugins_answer(plugins: Sequence[str]) -> Iterator[None]:
    """Raise PluginError in place of what a plugin's code raises here."""
    try:
        yield
    except (Exception, SystemExit) as error:
        if fault := plugin_fault(error, plugins):
            raise PluginError(fault) from error
        raise


NO_MEMORY = "out of memory; end other programs, or raise the limit of this one (ulimit -v)"


def is_lack_of_memory(error: BaseException) -> bool:
    """Whether an error says, in whatever way, that memory ran out."""
    if isinstance(error, ImportError):  # as the loader of compiled modules says it
        return "failed to map segment" in str(error) or "annot allocate memory" in str(error)
    return isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM)


def printable(text: str) -> str:
    """The text as one line of visible characters: a name in a run directory of another's cannot steer a terminal."""
    return "".join(c if c.isprintable() else " " if c.isspace() else "�" for c in text)
