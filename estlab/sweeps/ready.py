"""Jobs that are composed already, handed to any of Hydra's launchers: in a worker, nothing is composed again.

Each launcher asks its loader for the configuration of a job, by the job's words. Here a job has one word: itself.
"""

import base64
import copy
import pickle
from typing import TYPE_CHECKING

from omegaconf import DictConfig, OmegaConf, open_dict, read_write

from estlab.launch.composition import CheckedLoader
from estlab.launch.quoting import literal
from estlab.sweeps.job import Job

if TYPE_CHECKING:
    from hydra.types import HydraContext

_KEY = "estlab_job"


def packed(job: Job) -> str:
    """The word that stands for a job."""
    return f"+{_KEY}={base64.b64encode(pickle.dumps(job)).decode()}"


def job_of(config: DictConfig) -> Job:
    """The job in the configuration that a launcher got for its word."""
    job: Job = pickle.loads(base64.b64decode(str(config[_KEY])))
    return job


def context_of(context: "HydraContext") -> "HydraContext":
    """The context that a launcher is given, whose loader takes jobs' words."""
    found = copy.copy(context)
    found.config_loader = ReadyLoader(context.config_loader.get_search_path())
    return found


class ReadyLoader(CheckedLoader):
    """A loader that gives the configuration of a ready job."""

    def load_sweep_config(self, master_config: DictConfig, sweep_overrides: list[str]) -> DictConfig:
        """What a launcher needs to know of a job, of which the sweep's own configuration has the most.

        Callbacks of the user's are given the job's whole configuration, and for them alone it is made.
        """
        (word,) = sweep_overrides
        place = word.partition("=")[2]
        job = job_of(OmegaConf.create({_KEY: place}))
        config = OmegaConf.create(dict(job.plain) if master_config.hydra.callbacks else {})
        hydra = copy.deepcopy(master_config.hydra)
        with read_write(hydra), open_dict(hydra), open_dict(config):
            for key in ("name", "chdir", "override_dirname", "id", "num", "env_set", "env_copy"):
                hydra.job[key] = job.hydra_job[key]
            hydra.overrides.task = list(job.words)
            hydra.sweep.dir, hydra.sweep.subdir = literal(job.sweep), literal(job.name)
            config.hydra = hydra
            config[_KEY] = place
        OmegaConf.copy_cache(from_config=master_config, to_config=config)
        return config
