"""Runs Hydra's jobs on the workers of a dask.distributed cluster: one on this machine, or one that already runs."""

import pickle
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from hydra.core.singleton import Singleton
from hydra.core.utils import JobReturn, JobStatus, run_job, setup_globals
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, open_dict

if TYPE_CHECKING:
    from distributed import Client


# One thread of arithmetic per worker, as Dask sets it, but without its MALLOC_TRIM_THRESHOLD_: with it every large
# array is returned to the system at once, which then takes more time than the arithmetic.
_WORKERS = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), 1)


class DaskLauncher(Launcher):
    """One task per job. A worker that dies takes its own job with it, and the scheduler gives it to another."""

    def __init__(self, address: str | None, workers: int | None, allowed_failures: int, patience: float) -> None:
        self.address, self.workers, self.allowed_failures = address, workers, allowed_failures
        self.patience = patience

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        self.context, self.task_function, self.config = hydra_context, task_function, config

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        import cloudpickle

        self._check()
        with self._client() as client:
            everything = cloudpickle.dumps((self.context, self.config, self.task_function, Singleton.get_state()))
            # A task's result, which is computed again if the worker that holds it dies; scattered data would be lost.
            shared = client.submit(_same, everything, pure=False)
            numbered = enumerate(job_overrides, initial_job_idx)
            futures = [client.submit(_run, shared, list(words), number, pure=False) for number, words in numbered]
            return [_returned(future) for future in futures]

    def _check(self) -> None:
        """Raise UserError for settings on which Dask would wait forever, or that it reports badly."""
        from estlab.errors import UserError

        least = {"workers": 1, "allowed_failures": 0, "patience": 0}
        for key, value in ((key, getattr(self, key)) for key in least):
            number = isinstance(value, int) or (key == "patience" and isinstance(value, float))
            if value is None and key == "workers":
                continue
            if not number or isinstance(value, bool) or not least[key] <= value < 1e6:
                kind = "a number" if key == "patience" else "an integer"
                raise UserError(f"hydra.launcher.{key} must be {kind} from {least[key]} to 1e6, got {value}")

    @contextmanager
    def _client(self) -> "Iterator[Client]":
        import dask
        from distributed import Client, LocalCluster

        from estlab.errors import UserError

        if self.address is None:
            with (
                # One job per worker at a time, so that a death affects one job.
                dask.config.set({"distributed.scheduler.allowed-failures": self.allowed_failures,
                                 "distributed.scheduler.worker-saturation": 1.0,
                                 "distributed.nanny.pre-spawn-environ": _WORKERS}),
                LocalCluster(n_workers=self.workers, threads_per_worker=1, host="127.0.0.1",
                             dashboard_address=":0", silence_logs="CRITICAL") as cluster,
                Client(cluster) as client,
            ):  # fmt: skip
                yield client
            return
        try:
            client = Client(self.address, timeout=self.patience)
        except (OSError, ValueError) as error:
            raise UserError(f"hydra.launcher.address={self.address}: no scheduler answers there ({error})") from error
        with client:
            yield client


def _same(everything: bytes) -> bytes:
    return everything


def _run(everything: bytes, words: list[str], number: int) -> JobReturn:
    """In a worker: what Hydra's own launchers do in theirs."""
    context, config, task_function, singletons = pickle.loads(everything)
    setup_globals()
    Singleton.set_state(singletons)
    job_config = context.config_loader.load_sweep_config(config, words)
    with open_dict(job_config):
        job_config.hydra.job.id = job_config.hydra.job.num = number
    return run_job(task_function, job_config, "hydra.sweep.dir", "hydra.sweep.subdir", context)


def _returned(future: Any) -> JobReturn:
    """A job's return, or the reason why there is none, such as killed workers."""
    try:
        return future.result()
    except Exception as error:
        lost = JobReturn(status=JobStatus.FAILED)
        lost.return_value = error
        return lost
