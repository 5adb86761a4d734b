"""A job in its own process, so that a time limit really ends it."""

import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import NoReturn

from estlab import rundir
from estlab.launch.launcher import FAILED, OK
from estlab.parallel.signals import interruptible
from estlab.sweeps import state
from estlab.sweeps.job import Job


def run_for(job: Job, limit: float) -> int:
    """Run a job for at most so many seconds, start included. Returns the exit code. Its status says why it ended."""
    sweep, name = Path(job.sweep), job.name
    alive, held = os.pipe()
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with tempfile.TemporaryFile() as output:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "estlab.sweeps.child", str(alive)],
            stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=output,
            pass_fds=[alive], env=environment, start_new_session=True,
        )  # fmt: skip
        os.close(alive)
        try:
            process.communicate(pickle.dumps(job), timeout=limit)
        except subprocess.TimeoutExpired:
            _kill(process)
            if state.outcome(sweep, name).whole:
                return OK
            rundir.end(sweep, name, f"took longer than sweep.timeout={limit:g} s and was ended")
            return FAILED
        except BaseException:
            _ask_to_end(process)
            raise
        finally:
            os.close(held)
        if state.outcome(sweep, name).state in ("left", "running"):
            output.seek(0)
            rundir.end(sweep, name, _last_words(process.returncode, output.read().decode(errors="replace")))
            return FAILED
        return process.returncode


def _kill(process: "subprocess.Popen[bytes]") -> None:
    """End the process and all that it started."""
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        process.kill()
    process.wait()


def _ask_to_end(process: "subprocess.Popen[bytes]") -> None:
    process.terminate()
    try:
        process.wait(5)
    except subprocess.TimeoutExpired:
        _kill(process)


def _last_words(code: int, output: str) -> str:
    how = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}, but no status"
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    return f"its process ended with {how}" + (f": {lines[-1]}" if lines else "")


def main() -> int:
    """Run the job from standard input, and end when the process that holds the pipe does."""
    interruptible()
    job: Job = pickle.load(sys.stdin.buffer)
    threading.Thread(target=_end_with, args=[int(sys.argv[1])], daemon=True).start()
    try:
        return job.run()
    except KeyboardInterrupt:
        return FAILED


def _end_with(pipe: int) -> NoReturn:
    os.read(pipe, 1)
    os._exit(FAILED)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("estlab.sweeps.child is started by a sweep with sweep.timeout")
    code = main()
    sys.exit(OK if code == OK else code)
