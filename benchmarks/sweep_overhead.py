"""What estlab's sweeper costs beside Hydra's own: the same jobs by both, a stub and a real tiny run each.

    python benchmarks/sweep_overhead.py [JOBS]

Each sweep is a process of its own, best of three of wall and of processor time.
The stub does nothing but write an ok status and a metric, so that
its time is the sweeper's; plots are part of estlab's.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

REPEATS = 3
REAL = ["scenario=landmark", "filter=ekf", "runs=2", "steps=5"]
STUB = """
import json, sys
from pathlib import Path
import estlab.cli.main, estlab.launch.composed, estlab.sweeps.job
from hydra.core.hydra_config import HydraConfig
from estlab.sweeps.state import fingerprint
METRICS = "filter,metric,component,unit,value,ci_low,ci_high,n\\nekf,rmse,x,m,%s,0,2,2\\n"
def stub(*arguments):
    plain, names = estlab.launch.composed.described(arguments[-1])
    return write(Path(HydraConfig.get().runtime.output_dir), plain, fingerprint(plain, names.scenario, names.filter))
def perform(job, ours):
    folder = Path(job.sweep, job.name)
    folder.mkdir(exist_ok=True)
    return write(folder, job.plain, job.fingerprint)
def write(folder, plain, mark):
    facts = {"wall_time_s": 0.0, "fingerprint": mark}
    (folder / "metrics.csv").write_text(METRICS % plain["seed"])
    (folder / "run.json").write_text(json.dumps(facts))
    (folder / "stub.json").write_text('{"status": "ok"}')
    (folder / "stub.json").rename(folder / "status.json")
    return 0
"""
RUN = {
    "stub": STUB
    + "import estlab.sweeps.rounds\nestlab.cli.main.run_job = stub\n"
    + "estlab.sweeps.rounds.perform = estlab.sweeps.job.perform = perform\n",
    "real": "import estlab.cli.main\n",
}
MAIN = "import sys; sys.exit(estlab.cli.main.main(['sweep', *sys.argv[1:]]))"


def seconds(kind: str, words: list[str]) -> tuple[float, float]:
    """Wall and processor time of a sweep in a new folder."""
    with tempfile.TemporaryDirectory() as folder:
        before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run(
            [sys.executable, "-c", RUN[kind] + MAIN, *REAL, *words],
            cwd=folder, check=True, stdout=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[1]), *sys.path])},
        )  # fmt: skip
        wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    jobs = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    seeds = f"seed=range(1,{jobs + 1})"
    print(f"{jobs} jobs          Hydra basic [s]  estlab [s]  ratio")
    for kind in RUN:
        # By turns, so that what else the machine does strikes both.
        pairs = [(seconds(kind, [seeds, "hydra/sweeper=basic", "plots=false"]), seconds(kind, [seeds]))
                 for _ in range(REPEATS)]  # fmt: skip
        for what, of in (("wall", 0), ("cpu", 1)):
            hydra, ours = (min(pair[sweeper][of] for pair in pairs) for sweeper in (0, 1))
            print(f"{kind:6s}{what:10s}  {hydra:15.2f}  {ours:10.2f}  {ours / hydra:5.2f}", flush=True)


if __name__ == "__main__":
    main()
