"""Checks that the parts of a configuration fit together, before anything is made from them."""

import numpy as np

from estlab.config import expectations
from estlab.config.settings import Settings
from estlab.errors import UserError
from estlab.experiment.monte_carlo import loop_of
from estlab.experiment.plugin_errors import plugins_named
from estlab.parallel import cores
from estlab.record import SMOOTHED

_CROWDED = 4  # processes per core that may be requested


@plugins_named
def check(settings: Settings) -> None:
    """Raise UserError if the parts do not fit together, before anything is made."""
    data = settings.data
    if data.source == "simulated" and (data.path is not None or data.prefix):
        key = f"data.prefix={data.prefix}" if data.path is None else f"data.path={data.path}"
        raise UserError(f"{key} would not be read: add data=files")
    _check_file_names(settings)
    truth = settings.noise.truth
    if settings.data.source == "files" and (truth.process_scale, truth.measurement_scale) != (1.0, 1.0):
        raise UserError("noise.truth has no effect on a recording; leave it at 1, or set data=simulated")
    if settings.cores is not None and settings.cores > _CROWDED * cores.usable():
        raise UserError(
            f"cores={settings.cores} is far more than the {cores.usable()} that this process may use, and "
            "each is a process with its own memory; leave it out to use all"
        )
    for name, filter in settings.filters.items():
        key = settings.filter_key(name)
        loop = loop_of(settings, filter, np.empty((0, 1)))
        try:
            loop.check()
        except ValueError as error:
            raise UserError(f"{key}.{error}") from error
        except ArithmeticError as error:
            raise UserError(f"{key} or noise.filter is so large or small that numbers overflow ({error})") from error
        if loop.compiles:
            cores.enough_memory("engine=compiled")
        try:
            loop.check_engine()
        except ValueError as error:
            raise UserError(f"engine={settings.engine} with {name}: {error}") from error
        if settings.smooth:
            try:
                loop.check_smoother()
            except ValueError as error:
                raise UserError(f"smooth=true with {name}: {error}") from error
    endings = ("", SMOOTHED) if settings.smooth else ("",)
    estimates = [name + end for name in settings.filters for end in endings]
    expectations.parse(settings.expect, estimates)
    expectations.parse_sets(settings.expect_files, estimates)


def _check_file_names(settings: Settings) -> None:
    kinds = list(settings.scenario.file_names)
    for kind, name in settings.data.files.items():
        if settings.data.source == "simulated":
            raise UserError(f"data.files.{kind}={name} would not be read: add data=files")
        if kind not in kinds:
            raise UserError(
                f"data.files.{kind}: the scenario has no such file; its files are {', '.join(kinds) or 'none'}"
            )
