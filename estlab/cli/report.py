"""estlab report: pages drawn again from directories."""

from pathlib import Path

from estlab.errors import UserError, printable

HELP = """\
estlab report DIR [DIR ...]

Draws report.html in each directory of a run or a sweep, from the files there alone: one file with verdicts, tables,
plots, configuration and provenance, to open in a browser or send to somebody; it needs no network. A run writes it at
its end (report=false leaves it out), and the same directory gives the same page. What a directory holds is shown as
data: nothing in it is imported or run, and no link in it is followed.

Exit codes: 0 ok, 1 a page could not be written, 2 usage, 130 interrupted.
"""


def report(arguments: list[str]) -> None:
    """Draw the pages that the words ask for and print where they are.

    Raises UserError before any is drawn if a directory is not a run's or a sweep's.
    """
    if {"-h", "--help"} & set(arguments):
        print(HELP, end="")
        return
    from estlab.report import page

    if flag := next((word for word in arguments if word.startswith("-")), None):
        raise UserError(f"estlab report takes directories and --help, not {flag}")
    if not arguments:
        raise UserError("estlab report takes the directory of a run or a sweep, for example estlab report runs/latest")
    for word in arguments:
        page.is_sweep(Path(word))
    for word in arguments:
        print(printable(str(page.write(Path(word)))))


def folders(begun: str) -> list[str]:
    """The folders whose path begins so, for the shell to complete."""
    above, slash, begins = begun.rpartition("/")
    try:
        found = sorted(path.name for path in Path(above + slash or ".").iterdir() if path.is_dir())
    except OSError:
        return []
    shown = [name for name in found if name.startswith(begins) and (begins or not name.startswith("."))]
    return [f"{above}{slash}{name}/" for name in shown]
