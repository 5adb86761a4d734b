"""estlab.run: an experiment in this process."""

from os import PathLike, fspath
from pathlib import Path
from typing import Any

from estlab import rundir
from estlab.api.progress_reports import Report, progress_of
from estlab.api.run import Run
from estlab.api.run_sources import Computed
from estlab.api.words import words_of
from estlab.config import expectations
from estlab.errors import EstlabError, UserError
from estlab.experiment.compute import Progress, compute
from estlab.experiment.result import Result
from estlab.launch.execute import Audience, Request, execute
from estlab.launch.in_process import compose, hydra_apart
from estlab.parallel import cores
from estlab.rundir import finished


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

    Raises UserError for what is wrong with the configuration or the data; PluginError for an exception in a plugin's
    code; IncompleteError for a run that lacks something it needs. All are EstlabErrors, with the command line's line.
    Expectations that are not met raise nothing: see :attr:`Run.unmet`.

    Threads take turns. Workers share the runs where it pays (``cores``); they do not import your script. NumPy's linear
    algebra has one thread meanwhile, as on the command line.

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
    cores.enough_memory("estlab run")
    # What a plugin needs on sys.path stays there until the run has ended, and goes with the rest.
    with hydra_apart(), cores.memory_given_back(), cores.one_thread_meanwhile():
        request, place = compose(arguments)
        if request.plain.get("part"):
            raise UserError("part is of the jobs of a sweep; leave it out")
        shown = progress_of(
            progress, " ".join([request.names.scenario, *(request.plain["filters"] or [request.names.filter])])
        )
        return _saved(request, place, shown) if save else _in_memory(request, shown)


def _in_memory(request: Request, progress: Progress) -> Run:
    result = compute(request.settings(), progress=progress)
    result.attempts.complete("nothing, since it was not saved")
    unmet = expectations.unmet(result.expected)
    status = {"status": "unmet" if unmet else "ok", "error": unmet}
    return Run(Computed(result, request.plain, {**result.facts, "missing": result.attempts.missing}, status))


def _saved(request: Request, place: Path, progress: Progress) -> Run:
    """Run in a directory of its own, as the command line does, but for what it prints."""
    settings = request.settings()
    directory = rundir.RunDirectory(place)
    directory.link_latest(Path(settings.output))
    results: list[Result] = []
    errors: list[BaseException] = []
    messages: list[str] = []

    def complain(message: str, code: int) -> int:
        messages.append(message)
        return code

    audience = Audience(progress, lambda result, _: results.append(result), complain, errors.append)
    execute(request, directory, settings, audience=audience)
    if errors:
        raise errors[0] if not isinstance(errors[0], OSError) else EstlabError(messages[0]) from errors[0]
    facts, status = directory.facts(), finished.status(directory.path)
    return Run(Computed(results[0], request.plain, facts, status, directory.path))
