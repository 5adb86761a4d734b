"""``python -m estlab`` is ``estlab``."""

from estlab.cli.main import main

if __name__ == "__main__":
    raise SystemExit(main())
