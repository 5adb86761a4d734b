"""``python -m estlab`` is ``estlab``."""

from estlab.cli.main import command

if __name__ == "__main__":
    raise SystemExit(command())
