"""report.html: one file that shows a run or a sweep, without network or server, the same whenever it is drawn."""

from base64 import b64encode
from hashlib import sha256
from pathlib import Path
from string import Template

from estlab import rundir
from estlab.errors import UserError
from estlab.report.contents import Contents
from estlab.report.markup import text
from estlab.report.run_page import run_page
from estlab.report.sections import Page
from estlab.report.sweep_page import sweep_page
from estlab.rundir.files import write_text
from estlab.rundir.layout import PLAN, REPORT, SWEEP

_HERE = Path(__file__).parent


def write(path: Path) -> Path:
    """Draw the page of a directory and write it there.

    Raises UserError for a directory of neither a run nor a sweep, OSError if it cannot be written.
    """
    return write_text(path, REPORT, draw(path))


def draw(path: Path) -> str:
    """The page of a directory, only from its content.

    Raises UserError for a directory of neither a run nor a sweep.
    """
    contents = Contents(path)
    return _whole(sweep_page(contents) if is_sweep(path) else run_page(contents))


def is_sweep(path: Path) -> bool:
    """Whether a directory is a sweep's; otherwise it is a run's.

    Raises UserError for one that is neither.
    """
    contents = Contents(path)
    if not path.is_dir():
        raise UserError(f"{path}: no such directory")
    if contents.has(rundir.STATUS):
        return False
    if contents.has(PLAN) or contents.has(SWEEP):
        return True
    if contents.has(rundir.RUN) or contents.has(rundir.METRICS):
        return False
    raise UserError(f"{path}: holds neither a run nor a sweep; name a directory that estlab run or estlab sweep made")


def _whole(page: Page) -> str:
    """The file: style and script inside it, allowed by their hashes, so that nothing else can run."""
    template, style, script = ((_HERE / f"page.{end}").read_text(encoding="utf-8") for end in ("html", "css", "js"))
    return Template(template).substitute(
        title=text(page.title),
        head=page.head,
        contents=page.contents(),
        sections=page.body(),
        style=style,
        style_hash=_hash(style),
        script=script,
        script_hash=_hash(script),
    )


def _hash(content: str) -> str:
    return b64encode(sha256(content.encode()).digest()).decode()
