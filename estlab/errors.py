"""The errors that a user sees."""

import errno
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple


class EstlabError(Exception):
    """The base of estlab's errors. The message is one line."""


class UserError(EstlabError):
    """A mistake that the user can correct. The message is one line: what is wrong, where, and the remedy."""


class AnswerError(UserError):
    """A user's model, record or filter that violates its contract."""


class WorkerLostError(EstlabError):
    """A process that shared the work died before it finished. The message is one line, with the remedy."""


class IncompleteError(EstlabError):
    """Something that a run needs could not be computed. The message is one line, and says what is kept."""


class PluginError(EstlabError):
    """An exception in the user's own code. The message is one line: where it was raised, and what it says."""


class Frame(NamedTuple):
    """A place that an exception passed through."""

    module: str
    function: str
    line: int


def frames(error: BaseException) -> list[Frame]:
    """The path of an exception, outermost first; its last part is the path in the worker process that it came from."""
    here = [
        Frame(str(frame.f_globals.get("__name__")), frame.f_code.co_qualname, line)
        for frame, line in traceback.walk_tb(error.__traceback__)
    ]
    return here + getattr(error, "frames_in_worker", [])


def plugin_fault(error: BaseException, plugins: Sequence[str]) -> str:
    """In one line, where a plugin's code raised an exception and what it says; empty if it is not a plugin's.

    It belongs to a plugin if it passed through one, which is responsible for what it calls. Errors with a one-line
    message belong to nobody.
    """
    if isinstance(error, (UserError, WorkerLostError, IncompleteError, PluginError, Warning)) or is_lack_of_memory(
        error
    ):
        return ""
    theirs = [frame for frame in frames(error) if frame.module.partition(".")[0] in plugins]
    if not theirs:
        return ""
    message = " ".join(str(error).split())
    where = f"{theirs[-1].module}.{theirs[-1].function}, line {theirs[-1].line}"
    return f"{where}, raised {type(error).__name__}" + (f": {message}" if message else "")


@contextmanager
def plugins_answer(plugins: Sequence[str]) -> Iterator[None]:
    """Raise PluginError in place of any exception that a plugin's code raises here."""
    try:
        yield
    except (Exception, SystemExit) as error:
        if fault := plugin_fault(error, plugins):
            raise PluginError(fault) from error
        raise


NO_MEMORY = "out of memory; end other programs, or raise the limit of this one (ulimit -v)"


def is_lack_of_memory(error: BaseException) -> bool:
    """Whether an error means, in any form, that memory ran out."""
    if isinstance(error, ImportError):  # the message of the loader of compiled modules
        return "failed to map segment" in str(error) or "annot allocate memory" in str(error)
    return isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM)


def printable(text: str) -> str:
    """The text as one line of visible characters: names in another person's run directory cannot control a terminal."""
    return "".join(c if c.isprintable() else " " if c.isspace() else "�" for c in text)
