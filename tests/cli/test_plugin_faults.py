"""What the code of a user's plugin raises is said to be its own: module, function, line."""

import errno
import importlib
import pickle
import sys

import pytest

from estlab.cli.main import main
from estlab.errors import UserError, plugin_fault, plugins_answer
from estlab.experiment.attempts import Attempts
from estlab.launch.execute import Audience, concluded
from estlab.parallel.worker import _portable
from estlab.rundir import RunDirectory
from tests.cli.test_readme import block

SOURCE = block("pendulum.py")


@pytest.fixture
def pendulum(tmp_path, monkeypatch):
    """Writes the README's plugin where the user stands, changed, and runs it; exit code and what is said."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    (tmp_path / "conf/scenario").mkdir(parents=True)
    (tmp_path / "conf/scenario/pendulum.yaml").write_text(block("pendulum.yaml"))

    def run(capsys, *change):
        (tmp_path / "pendulum.py").write_text(SOURCE.replace(*change, 1))
        importlib.invalidate_caches()
        sys.modules.pop("pendulum", None)
        words = "run --config-dir conf scenario=pendulum plugins=[pendulum] filter=ekf runs=2 steps=3 report=false"
        try:
            code = main([*words.split(), "plots=false"])
        finally:
            sys.modules.pop("pendulum", None)
        return code, capsys.readouterr().err

    return run


def line(text, source=SOURCE):
    """The number of the line that has this text."""
    return next(i for i, row in enumerate(source.splitlines(), 1) if text in row)


@pytest.mark.parametrize(
    ("right", "wrong", "where", "said"),
    [
        ("np.sin(angle))\n    return angle", "npp.sin(angle))\n    return angle",
         f"pendulum.swing, line {line('faster = rate')}", "NameError: name 'npp' is not defined"),
        ("        time =", "        open('commands.csv')\n        time =",
         f"pendulum.Pendulum.simulate, line {line('        time =')}",
         "FileNotFoundError: [Errno 2] No such file or directory: 'commands.csv'"),
        ("        time =", "        raise OSError\n        time =",
         f"pendulum.Pendulum.simulate, line {line('        time =')}", "OSError"),
    ],
)  # fmt: skip
def test_a_run_that_a_plugin_breaks_names_the_plugin(pendulum, capsys, right, wrong, where, said):
    code, err = pendulum(capsys, right, wrong)
    assert code == 1
    assert err.startswith(f"estlab: {where}, raised {said}; the traceback is in ")
    assert err.count("\n") == 1
    assert "internal error" not in err


@pytest.mark.parametrize(
    ("right", "wrong", "said"),
    [
        ("READING = Space", "open('table.csv')\nREADING = Space",
         "pendulum.<module>, line {}, raised FileNotFoundError: "),
        ("        check_positive(", "        self.start()\n        check_positive(",
         "pendulum.Pendulum.__post_init__, line {}, raised AttributeError: "),
        ("        variance =", "        variance = 1 / 0\n        variance =",
         "pendulum.Pendulum.motion, line {}, raised ZeroDivisionError: division by zero"),
        ("    def motion(", "    def notion(", "scenario: pendulum.Pendulum has no motion; define it"),
    ],
)  # fmt: skip
def test_a_plugin_that_breaks_before_a_run_is_named_and_leaves_no_directory(
    pendulum, capsys, tmp_path, right, wrong, said
):
    code, err = pendulum(capsys, right, wrong)
    assert code == 2
    assert err.startswith("estlab: " + said.format(line(right)))
    assert err.count("\n") == 1
    assert not list((tmp_path / "runs").rglob("status.json"))


def _raised(error):
    """An exception that passed through this module."""
    with pytest.raises(type(error)) as caught:
        raise error
    return caught.value


def test_a_fault_is_the_plugins_whose_code_it_passed_through_and_no_others():
    here = "tests.cli.test_plugin_faults._raised, line "
    assert plugin_fault(_raised(KeyError("x")), ["tests"]).startswith(here)
    assert plugin_fault(_raised(KeyError("x")), ["test", "estlab"]) == ""
    assert plugin_fault(_raised(UserError("said")), ["tests"]) == ""
    assert plugin_fault(_raised(MemoryError()), ["tests"]) == ""
    with pytest.raises(KeyError), plugins_answer(["others"]):
        raise KeyError("x")


def test_a_fault_in_a_worker_keeps_its_place():
    class LocalError(Exception):
        """It cannot be pickled."""

    for error in (ValueError("x"), LocalError("x")):
        carried = pickle.loads(_portable(_raised(error)))
        assert plugin_fault(carried, ["tests"]).startswith("tests.cli.test_plugin_faults._raised, line ")


def _fails(directory, error, capsys):
    def work():
        raise error

    assert concluded(directory, work, page=False, audience=Audience()) == 1
    return capsys.readouterr().err.removeprefix("estlab: ").strip()


def test_an_error_of_the_system_blames_the_run_directory_only_if_it_is_its_own(tmp_path, capsys):
    folder = tmp_path / "run"
    log = folder / "log.txt"

    def said(error):
        directory = RunDirectory(folder)
        text = _fails(directory, error, capsys)
        for file in folder.iterdir():
            file.unlink()
        folder.rmdir()
        return text

    own = str(folder / "metrics.csv")
    assert said(PermissionError(errno.EACCES, "denied", own)) == (
        f"{own}: denied; the run is incomplete, check its permissions"
    )
    assert said(OSError(errno.ENOSPC, "no space", own)) == (
        f"{own}: no space; the run is incomplete, free some space, or set output to another disk"
    )
    # Every file of a run is named, so this is another: shared memory, or a plugin's own.
    assert said(OSError(errno.ENOSPC, "no space")) == f"no space; the traceback is in {log}"
    assert said(FileNotFoundError(errno.ENOENT, "not there", "a.csv")) == f"a.csv: not there; the traceback is in {log}"
    assert said(OSError("odd")) == f"odd; the traceback is in {log}"
    assert said(OSError()) == f"OSError; the traceback is in {log}"
    # Whoever raises it in the rooms of the run directory speaks of it.
    source = compile("raise PermissionError(13, 'no answer')", "rundir", "exec")

    def in_rundir():
        exec(source, {"__name__": "estlab.rundir.write"})

    with pytest.raises(OSError, match="no answer") as caught:
        in_rundir()
    assert said(caught.value) == f"{folder}: no answer; the run is incomplete, check its permissions"


def test_a_picture_whose_file_a_plugin_misses_is_missing_and_the_run_goes_on():
    def draw():
        raise FileNotFoundError(errno.ENOENT, "not there", "icon.png")

    attempts = Attempts(["tests"])
    attempts.put("trajectory.png", draw)
    where = f"{__name__}.{draw.__qualname__}, line {draw.__code__.co_firstlineno + 1}"
    assert attempts.missing["trajectory.png"].startswith(f"{where}, raised FileNotFoundError: ")
    with pytest.raises(FileNotFoundError):
        Attempts().put("trajectory.png", draw)
