"""The commands on a configuration that Hydra composed: estlab run and estlab simulate."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from estlab.errors import UserError, printable
from estlab.launch.launcher import OK, remove_if_ours

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from estlab.config.expectations import Finding


def run_job(command: list[str], config: "DictConfig", on_end: "Callable[[list[Finding]], object] | None" = None) -> int:
    """Run an experiment. Returns its exit code. Reports errors in one line; only an interruption is raised.

    on_end: receives the findings about expectations.
    """
    from estlab import rundir
    from estlab.launch import composed
    from estlab.launch.execute import execute

    folder = composed.folder()
    try:
        request = composed.request_of(config, command)
        settings = request.settings()
        directory = rundir.RunDirectory(folder)
    except BaseException:
        remove_if_ours(folder, Path(str(config.output)))
        raise
    directory.link_latest(Path(settings.output))
    return execute(request, directory, settings, on_end)


def simulate_job(config: "DictConfig") -> int:
    """Write simulated data. Returns the exit code.

    Raises UserError for a configuration without data to simulate.
    """
    from estlab.config.build import build
    from estlab.experiment.simulate import simulate
    from estlab.launch import composed

    settings = build(*composed.described(config))
    if not settings.data.path:
        raise UserError("data.path is required: the folder to write to, for example data.path=mine")
    for path in simulate(settings):
        print(printable(str(path)))
    return OK
