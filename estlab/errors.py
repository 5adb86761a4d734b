"""The two ways in which a user is told no."""


class UserError(Exception):
    """A mistake that the user can mend. The message is one line: what is wrong, where, and the remedy."""


class RunFailure(Exception):
    """A run that had started could not be finished, for example because the disk is full."""
