"""engine=numba as a user meets it: what it refuses, and what it keeps between starts."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from estlab.cli import main
from tests import pendulum

WORDS = ["run", "scenario=landmark", "runs=2", "steps=10", "plots=false", "report=false", "engine=numba"]
TAKE = "; take engine=numpy"
KNOWN = f"it compiles ekf, ukf, ckf, ghkf and dead_reckoning, not this filter{TAKE}"
STACKED = "it compiles no scenario.update=stacked; take sequential, interleaved or engine=numpy"

# Prints how often compiled code was found in the folder, and the answer.
START = """
import model
from estlab.filters.compiled import cache
from estlab.filters.compiled.engine import CompiledLoop
from estlab.filters.gaussian import extended
from estlab.maths.streams import Streams

loop = CompiledLoop(extended("additive", None), model.MOTION, model.SENSOR)
found = loop.estimate(model.record(), Streams(1, "test").draws("filter", range(2)))
(forward,) = cache._BUILT.values()
print(sum(forward.stats.cache_hits.values()), repr(float(found.mean[0, -1, 0])))
"""


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["filter=pf"], f"engine=numba with pf: {KNOWN}"),
        (["filter=srukf"], f"engine=numba with srukf: {KNOWN}"),
        (["filter=second_order"], f"engine=numba with second_order: {KNOWN}"),
        (["filter=[ekf,iekf]"], f"engine=numba with iekf: {KNOWN}"),
        (["filter=ekf", "smooth=true"], f"smooth=true with ekf: engine=numba has no smoother{TAKE}"),
        (["filter=ekf", "scenario.update=stacked"], f"engine=numba with ekf: {STACKED}"),
        (
            ["scenario=sonar", "filter=ekf"],
            "engine=numba with ekf: estlab.scenarios.sonar.Sonar.sensor.<locals>.<lambda> is not a function of a "
            f"module, and only such are compiled{TAKE}",
        ),
    ],
)
def test_what_is_not_compiled_is_refused_in_one_line_before_anything_runs(words, said, capsys):
    pytest.importorskip("numba", reason="numba is not installed: pip install estlab[fast]")
    assert main([*WORDS, *words]) == 2
    assert capsys.readouterr().err == f"estlab: {said}\n"
    assert not any(Path("runs").rglob("*.*"))


def test_without_numba_one_line_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "numba", None)
    assert main([*WORDS, "filter=ekf"]) == 2
    assert capsys.readouterr().err == 'estlab: engine=numba needs numba: pip install "estlab[fast]"\n'
    assert not any(Path("runs").rglob("*.*"))


def test_the_default_engine_imports_no_numba():
    code = "import sys; from estlab.cli import main; main(sys.argv[1:]); assert 'numba' not in sys.modules"
    words = [word for word in WORDS if word != "engine=numba"]
    subprocess.run([sys.executable, "-c", code, *words, "filter=ekf"], check=True, capture_output=True)


def test_a_second_start_compiles_nothing_and_what_is_damaged_or_changed_is_compiled_anew(tmp_path):
    pytest.importorskip("numba", reason="numba is not installed: pip install estlab[fast]")
    source = Path(pendulum.__file__).read_text()
    model = tmp_path / "model.py"
    model.write_text(source)
    first, second = start(tmp_path), start(tmp_path)
    for index in (tmp_path / "cache").rglob("*.nbi"):
        index.write_bytes(index.read_bytes()[:20])
    mended = start(tmp_path)
    assert (mended[0], mended[1]) == ("0", first[1]), "what is damaged is made anew"
    # As long as it was, and in a function that another calls.
    model.write_text(source.replace("9.81", "9.18"))
    changed = start(tmp_path)
    assert (first[0], second[0], changed[0]) == ("0", "1", "0")
    assert first[1] == second[1] != changed[1]
    assert len(list((tmp_path / "cache" / "compiled").iterdir())) == 2


def start(folder):
    """What a process says that runs the model in this folder with the cache in it."""
    path = os.pathsep.join([str(folder), *sys.path])
    environment = os.environ | {
        "ESTLAB_CACHE": str(folder / "cache"),
        "PYTHONPATH": path,
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    done = subprocess.run([sys.executable, "-c", START], env=environment, capture_output=True, text=True, check=True)
    return done.stdout.split()


def test_who_writes_second_leaves_the_file_of_the_first(tmp_path, monkeypatch):
    pytest.importorskip("numba", reason="numba is not installed: pip install estlab[fast]")
    from estlab.filters.compiled import cache

    monkeypatch.setenv("ESTLAB_CACHE", str(tmp_path))
    path = cache._written("0", "one = 1\n")
    before = path.stat()
    assert cache._written("0", "one = 1\n") == path
    assert (path.stat().st_ino, path.stat().st_mtime_ns) == (before.st_ino, before.st_mtime_ns)
    assert [file.name for file in path.parent.iterdir()] == ["loop.py"]
    path.write_text("rubbish (")
    assert cache._written("0", "one = 1\n").read_text() == "one = 1\n"
