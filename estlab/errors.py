"""How a user is told no."""


class UserError(Exception):
    """A mistake that the user can mend. The message is one line: what is wrong, where, and the remedy."""
