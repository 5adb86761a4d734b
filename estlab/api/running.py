"""estlab.run: an experiment in this process."""

from collections.abc import Sequence
from dataclasses import asdict
from os import PathLike, fspath
from pathlib import Path
from typing import Any

from estlab import rundir
from estlab.api.progress_reports import Report, progress_of
from estlab.api.run import Run
from estlab.api.run_sources import Computed
from estlab.api.words import words_of
from estlab.config import expectations
from estlab.config.build import Settings, build
from estlab.errors import UserError
from estlab.experiment.compatibility import check
from estlab.experiment.compute import Progress, compute
from estlab.experiment.result import Result
from estlab.launch.in_process import Composition, compose, hydra_apart
from estlab.parallel import cores


def run(
    *words: str,
    save: bool = True,
    progress: bool | Report = False,
    config_dir: str | PathLike[str] | None = None,
    **keys: Any,
) -> Run:
    """Run an experiment in this process, as ``estlab run`` does on the command line, and return it.

    words: as they are typed there: "scenario=car", "filter=[ekf,ukf]", "+experiment=car_ekf", "filter.alpha=0.1".
    keys: the same as keywords: runs=200, filter=["ekf", "ukf"], noise={"filter": {"process_scale": 2.0}},
    experiment="car_ekf", or ``**{"filter.alpha": 0.1}``. They come after the words, and what comes later holds.
    save: False writes nothing to the disk; True makes a run directory as the command line does.
    progress: True shows how far the run is, on standard error; a function is called with the steps done and their
    number. Nothing is printed otherwise.
    config_dir: a folder of configuration of your own, as --config-dir.

    Raises UserError for what is wrong with the configuration or the data, before a run directory is made or after;
    PluginError for an exception in a plugin's code; IncompleteError for a run that lacks something it needs. Expectations
    that are not met raise nothing: see :attr:`Run.unmet`.

    Threads take turns. Workers share the runs where it pays (``cores``); they do not import your script. Set
    OPENBLAS_NUM_THREADS=1 before NumPy is imported to give each of them one thread, as the command line does.

    >>> import estlab
    >>> run = estlab.run("scenario=landmark", filter=["ekf", "ukf"], runs=4, steps=20, save=False)
    >>> run.filters
    ('ekf', 'ukf')
    >>> run.metrics.query("metric == 'rmse' and component == 'heading'")["n"].tolist()
    [4, 4]
    >>> estlab.run(scenario="landmark", filter={"gat": 0.99})
    Traceback (most recent call last):
    estlab.errors.UserError: unknown key filter.gat; did you mean filter.gate?
    """
    folder = [f"--config-dir={fspath(config_dir)}"] if config_dir is not None else []
    arguments = [*folder, *words_of(words, keys)]
    # What a plugin needs on sys.path stays there until the run has ended, and goes with the rest.
    with hydra_apart(), cores.memory_given_back():
        cores.enough_memory("estlab run")
        composition = compose(arguments)
        settings = build(composition.plain)
        if settings.part is not None:
            raise UserError(f"part={settings.part} is of a sweep's jobs; leave it out")
        check(settings, composition.names)
        shown = progress_of(progress, f"{composition.names.scenario} {' '.join(settings.filters or [composition.names.filter])}")
        if save:
            return _saved(settings, composition, shown, arguments)
        result = compute(settings, composition.names, progress=shown)
        result.attempts.complete("nothing, since it was not saved")
        return Run(_computed(result, composition, result.facts))


def _saved(settings: Settings, composition: Composition, progress: Progress, arguments: Sequence[str]) -> Run:
    """Run in a directory of its own, as the command line does, but for what it prints."""
    directory = rundir.RunDirectory(composition.folder)
    results: list[Result] = []
    errors: list[BaseException] = []
    messages: list[str] = []

    def work() -> str:
        try:
            results.append(_written(settings, composition, directory, progress, arguments))
        except BaseException as error:
            errors.append(error)
            raise
        return expectations.unmet(results[0].expected)

    def tell(message: str, code: int = 0) -> int:
        messages.append(message)
        return code

    concluded(directory, work, settings.report, tell)
    if errors and isinstance(errors[0], EstlabError | Warning) or (errors and not isinstance(errors[0], OSError)):
        raise errors[0]
    if errors:
        raise EstlabError(messages[0]) from errors[0]
    status = finished.status(directory.path)
    return Run(_computed(results[0], composition, directory.facts(), status, directory.path))


def _written(
    settings: Settings,
    composition: Composition,
    directory: rundir.RunDirectory,
    progress: Progress,
    arguments: Sequence[str],
) -> Result:
    """Every file of the directory but its status and page."""
    names = composition.names
