"""How a user is told no."""

import errno


class UserError(Exception):
    """A mistake that the user can mend. The message is one line: what is wrong, where, and the remedy."""


class WorkerLostError(Exception):
    """A process that shared the work ended before it was done. The message is one line, with the remedy."""


class IncompleteError(Exception):
    """Something that a run needs could not be computed. The message is one line, and says what is kept."""


NO_MEMORY = "out of memory; end other programs, or raise the limit of this one (ulimit -v)"


def is_lack_of_memory(error: BaseException) -> bool:
    """Whether an error says, in whatever way, that memory ran out."""
    if isinstance(error, ImportError):  # as the loader of compiled modules says it
        return "failed to map segment" in str(error) or "annot allocate memory" in str(error)
    return isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM)


def printable(text: str) -> str:
    """The text as one line of visible characters: a name in a run directory of another's cannot steer a terminal."""
    return "".join(c if c.isprintable() else " " if c.isspace() else "�" for c in text)
