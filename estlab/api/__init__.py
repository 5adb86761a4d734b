"""The door for Python: what ``import estlab`` offers. Each name is imported from here when it is first used."""

import logging

# A library prints nothing by itself: to see estlab's log, add a handler to this logger.
logging.getLogger("estlab").addHandler(logging.NullHandler())
