"""The pictures of a result as files: drawn on all cores, if processes can be forked."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from estlab import rundir
from estlab.experiment.result import Result
from estlab.parallel.pool import OnStep, Workers, can_fork
from estlab.report import plots
from estlab.report.figures import png

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Files = dict[str, bytes]
Task = Callable[[], Files]


class _Drawn(NamedTuple):
    """The files of one task, and why some of it is missing."""

    files: Files
    missing: dict[str, str]


@contextmanager
def drawn(result: Result) -> Iterator[Iterator[tuple[str, bytes]]]:
    """The name and content of each picture, as they are finished; another process starts with them at once.

    Anything that cannot be drawn is added to the missing parts of the result.
    """
    tasks = _tasks(result)

    def work(number: int, on_step: OnStep) -> _Drawn:
        files = tasks[number]()
        return _Drawn(files, result.attempts.missing)

    # Figures and a user's models cannot be pickled: without fork they are drawn here.
    with Workers(work, range(len(tasks)), result.settings.cores if can_fork() else 1) as workers:
        yield _collected(result, workers.results(work, lambda steps: None))


def _collected(result: Result, results: Iterator[tuple[int, _Drawn]]) -> Iterator[tuple[str, bytes]]:
    for _, one in results:
        result.attempts.missing |= one.missing
        yield from one.files.items()


def _tasks(result: Result) -> list[Task]:
    """Functions that draw one picture each; the problem's own come first, because they take longest."""
    attempts = result.attempts

    def draw(axes: "Axes", name: str, place: int) -> None:
        attempts.made("the problem's additions to pictures", lambda: result.add_to_picture(axes, name, place))

    def content(name: str, make: plots.Make) -> Files:
        path = f"{rundir.PLOTS}/{name}"
        figure = attempts.made(path, make)
        made = None if figure is None else attempts.made(path, lambda: png(figure))
        return {} if made is None else {path: made}

    def own() -> Files:
        figures = attempts.made("the problem's own pictures", lambda: scenario.pictures(result.histories)) or {}
        return {path: made for name in figures for path, made in content(name, partial(figures.get, name)).items()}

    scenario = result.settings.scenario
    return [own, *(partial(content, name, make) for name, make in plots.pictures(result.plot_data(draw)).items())]
