"""The sweepers of estlab, where Hydra looks for them: it accepts plugins only from this package."""

from typing import Any

from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig


class EstlabSweeper(Sweeper):
    """Every combination of the given values, or those that sweep.zip pairs, each repeated sweep.repeats times."""

    def __init__(self, params: dict[str, Any]) -> None:
        """params: keys with values to sweep, as an experiment states them; the command line takes precedence."""
        self.params = params

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        self.given = hydra_context, config

    def sweep(self, arguments: list[str]) -> Any:
        from estlab.sweeps.sweep import SweepRunner

        raise SystemExit(SweepRunner(*self.given).run(self.words(arguments)))

    def words(self, arguments: list[str]) -> list[str]:
        """The experiment's words, then the typed ones."""
        return [*(f"{key}={value}" for key, value in (self.params or {}).items()), *arguments]


class TuningSweeper(EstlabSweeper):
    """Settings chosen by Optuna, each from the results of the earlier ones."""

    def sweep(self, arguments: list[str]) -> Any:
        from estlab.sweeps.tuning import Tuning

        raise SystemExit(Tuning(*self.given).run(self.words(arguments)))
