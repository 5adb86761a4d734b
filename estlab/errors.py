"""How a user is told no."""


class UserError(Exception):
    """A mistake that the user can mend. The message is one line: what is wrong, where, and the remedy."""


class WorkerLostError(Exception):
    """A process that shared the work ended before it was done. The message is one line, with the remedy."""


class IncompleteError(Exception):
    """Something that a run needs could not be computed. The message is one line, and says what is kept."""


def printable(text: str) -> str:
    """The text as one line of visible characters: a name in a run directory of another's cannot steer a terminal."""
    return "".join(c if c.isprintable() else " " if c.isspace() else "�" for c in text)
