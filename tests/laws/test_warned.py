"""What is warned of during a run goes to its log in a line, and never to the terminal."""

import warnings

import numpy as np

from estlab import rundir
from estlab.cli.main import main
from estlab.python_warnings import in_a_line
from estlab.scenarios.sonar import Sonar

TINY = ("scenario=sonar", "filter=pf", "filter.particles=20", "runs=2", "steps=4", "plots=false", "report=false")


def test_a_warning_is_one_line_and_said_once():
    heard = []
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        with in_a_line(heard.append):
            for _ in range(3):
                warnings.warn("over\nflow \x07", RuntimeWarning, stacklevel=1)
            warnings.warn("another", UserWarning, stacklevel=1)
    assert [line.partition(" (")[0] for line in heard] == ["RuntimeWarning: over flow �", "UserWarning: another"]
    assert "test_warned.py, line" in heard[0]


def test_warnings_of_a_users_model_and_of_numpy_are_lines_of_the_log(monkeypatch, capsys, tmp_path):
    simulate = Sonar.simulate

    def noisy(scenario, *arguments):
        warnings.warn("a plugin's\nown", UserWarning, stacklevel=1)
        np.log(np.zeros(2))
        return simulate(scenario, *arguments)

    monkeypatch.setattr(Sonar, "simulate", noisy)
    monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        assert main(["run", *TINY, "hydra.run.dir=out"]) == 0
    assert capsys.readouterr().err == ""
    lines = [line for line in (tmp_path / "out" / rundir.LOG).read_text().splitlines() if " WARNING " in line]
    assert ["UserWarning: a plugin's own" in line for line in lines].count(True) == 1
    assert ["RuntimeWarning: divide by zero" in line for line in lines].count(True) == 1
