"""The door for Python: what ``import estlab`` offers. Each name is imported from here when it is first used."""

import logging

# A library prints nothing of its own accord: who wants estlab's log gives this logger a handler.
logging.getLogger("estlab").addHandler(logging.NullHandler())
