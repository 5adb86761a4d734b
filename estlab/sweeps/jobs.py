"""From the words of a sweep to its jobs. Each is composed once to find its name and its fingerprint."""

import os
import pickle
from collections.abc import Sequence
from itertools import islice
from typing import TYPE_CHECKING, Any

from estlab import rundir
from estlab.config import angles
from estlab.config.build import build
from estlab.config.groups import SweepSettings
from estlab.errors import UserError
from estlab.experiment.blocks import block_count
from estlab.launch.composed import described, typed
from estlab.launch.quoting import angle_as_typed, unquoted
from estlab.rundir.layout import ATTEMPTS
from estlab.sweeps import split
from estlab.sweeps.plan import MOST, combinations
from estlab.sweeps.state import Planned, fingerprint

if TYPE_CHECKING:
    from hydra.core.override_parser.types import Override
    from hydra.types import HydraContext
    from omegaconf import DictConfig

    from estlab.config.settings import Names

_FOLDERS = (ATTEMPTS, split.PARTS, rundir.PLOTS)  # of the sweep itself
_NAME_BYTES = 240  # characters of a folder's name; systems allow 255, with the additions of attempts/


def planned(
    context: "HydraContext", config: "DictConfig", words: Sequence[str], limits: SweepSettings
) -> list[Planned]:
    """The jobs of a sweep, in order.

    Raises UserError or Hydra's exceptions if any word cannot be composed: then no job starts.
    """
    fixed, overrides_of = parsed(context, words)
    swept = {key: _values(override) for key, override in overrides_of.items()}
    if limits.repeats > 1 and "seed" in swept:
        raise UserError("sweep.repeats repeats each job by seed; leave seed=... with several values out")
    jobs: list[Planned] = []
    for values in combinations({_bare(key): values for key, values in swept.items()}, limits.zip):
        chosen = [f"{key}={values[_bare(key)]}" for key in swept]
        overrides = [*fixed.values(), *chosen]
        job, plain, _ = composed(context, config, len(jobs), overrides, values, limits)
        if limits.repeats == 1:
            jobs.append(job)
            continue
        overrides = [word for word in overrides if not word.startswith("seed=")]
        seed = whole_seed(plain["seed"])
        for seed_of_repeat in range(seed, seed + limits.repeats):
            again = [*overrides, f"seed={seed_of_repeat}"]
            named = {**values, "seed": str(seed_of_repeat)}
            jobs.append(composed(context, config, len(jobs), again, named, limits)[0])
    names = [job.name for job in jobs]
    if len(set(names)) < len(names):
        raise UserError("hydra.sweep.subdir gives several jobs one directory; put ${hydra:job.num} in it")
    return jobs


def parsed(context: "HydraContext", words: Sequence[str]) -> "tuple[dict[str, str], dict[str, Override]]":
    """The words common to all jobs, and the keys with several values; later words override earlier ones.

    Raises UserError for keys that a sweep's jobs cannot have.
    """
    from hydra.core.override_parser.overrides_parser import OverridesParser

    fixed: dict[str, str] = {}
    swept: dict[str, Override] = {}
    for override in OverridesParser.create(config_loader=context.config_loader).parse_overrides(list(words)):
        key, word = override.get_key_element(), str(override.input_line)
        fixed.pop(key, None)
        swept.pop(key, None)
        if _bare(key) in ("part", "parts"):
            raise UserError(f"{word}: a sweep splits its jobs itself; write sweep.split_runs=16 instead")
        if not override.is_sweep_override():
            fixed[key] = word
        elif key.startswith("sweep.") or key == "objective":
            raise UserError(f"{word}: keys under sweep apply to the whole sweep; give one value")
        else:
            swept[key] = override
    if "plots" not in {_bare(key) for key in [*fixed, *swept]}:
        fixed["plots"] = "plots=false"  # a sweep draws its plots once, at its end
    return fixed, swept


def _values(override: "Override") -> list[str]:
    word = override.input_line
    if not override.is_discrete_sweep():
        raise UserError(
            f"{word}: an interval is not a list of values; write range(...), or tune it: hydra/sweeper=optuna"
        )
    if getattr(override.value(), "shuffle", False):
        raise UserError(f"{word}: leave shuffle out; a sweep's jobs keep their order so that you can resume it")
    try:
        values = [angle_as_typed(value) for value in islice(override.sweep_string_iterator(), MOST + 1)]
    except ValueError as error:
        raise UserError(f"{word}: {error}") from error
    if not values:
        raise UserError(f"{word}: there is no value in it")
    return values


def composed(
    context: "HydraContext",
    config: "DictConfig",
    number: int,
    overrides: list[str],
    values: dict[str, str],
    limits: SweepSettings,
) -> "tuple[Planned, dict[str, Any], Names]":
    """A job, its configuration as plain data, and the user's names for its parts."""
    from hydra.core.hydra_config import HydraConfig
    from omegaconf import OmegaConf, open_dict, read_write

    job_config = context.config_loader.load_sweep_config(config, overrides)
    with open_dict(job_config):
        job_config.hydra.job.num = number
        job_config.hydra.job.id = str(number)
    before = HydraConfig.instance().cfg
    HydraConfig.instance().set_config(job_config)
    try:
        name = str(HydraConfig.get().sweep.subdir).replace("/", "-")
        hydra_job = OmegaConf.to_container(job_config.hydra.job, resolve=False)
        words = tuple(typed())
        with read_write(job_config), open_dict(job_config):
            del job_config["hydra"]
        plain, names = described(job_config)
    finally:
        HydraConfig.instance().cfg = before
    _check_folder(name)
    resolved = {key: str(angles.resolved(unquoted(value))) for key, value in values.items()}
    mark = fingerprint(plain, names.scenario, names.filter)
    parts = _parts(plain, names, limits.split_runs)
    ready = pickle.dumps((plain, names, words, hydra_job), pickle.HIGHEST_PROTOCOL)
    return Planned(number, name, tuple(overrides), resolved, mark, parts, ready), plain, names


def _check_folder(name: str) -> None:
    """Raise UserError if a job would not get its own folder inside the sweep's."""
    of_the_sweep = name in _FOLDERS or name.startswith(".") or name.endswith((".json", ".csv", ".html"))
    if not name or of_the_sweep or len(os.fsencode(name)) > _NAME_BYTES:
        raise UserError(
            f"hydra.sweep.subdir gives a job the folder {name!r}, which is not possible; leave it out, or "
            f"include ${{hydra:job.num}}"
        )


def _parts(plain: dict[str, Any], names: "Names", most: int) -> int:
    """The number of parts in which a job can run: each part has at least one block of runs."""
    if most == 1:
        return 1
    try:
        return min(most, block_count(build(plain, names)))
    except UserError:
        return 1  # the job itself will report what is wrong


def whole_seed(seed: object) -> int:
    """The seed of a configuration. Raises UserError if it is invalid."""
    whole = int(seed) if isinstance(seed, float) and seed.is_integer() else seed
    if not isinstance(whole, int) or not 0 <= whole < 2**63:
        raise UserError(f"seed must be an integer from 0 to 9e18, got {seed!r}")
    return whole


def _bare(key: str) -> str:
    return key.lstrip("+")
