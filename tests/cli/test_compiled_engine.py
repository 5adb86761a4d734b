"""engine=compiled and engine=auto as a user meets them: what is refused, and what is kept between starts."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from estlab.cli.main import main
from estlab.compiled import cache
from tests import pendulum
from tests.tracing import compiled

WORDS = ["run", "scenario=landmark", "runs=2", "steps=10", "plots=false", "report=false"]
TAKE = "; set engine=numpy"
KNOWN = (
    "it compiles ekf, iekf, second_order, ukf, ckf, ghkf, srukf, srckf, dead_reckoning, pf, rpf and apf, "
    f"not this filter{TAKE}"
)
STACKED = (
    "it compiles no scenario.update=stacked with noise=augmented, whose number of points depends on "
    "the number of readings"
    f"{TAKE}"
)

# Prints whether compiled code was found in the folder, and the answer.
START = """
import logging
import model
from estlab.filters.engine import CompiledLoop
from estlab.filters.gaussian import extended
from estlab.maths.streams import Streams

lines = []
handler = logging.Handler()
handler.emit = lambda record: lines.append(record.getMessage())
log = logging.getLogger("estlab")
log.setLevel("INFO")
log.addHandler(handler)
loop = CompiledLoop(extended("additive", None), model.MOTION, model.SENSOR)
found = loop.estimate(model.record(), Streams(1, "test").draws("filter", range(2)))
print(sum("found compiled" in line for line in lines), repr(float(found.mean[0, -1, 0])))
"""


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["filter=enkf"], f"engine=compiled with enkf: {KNOWN}"),
        (["filter=[ekf,enkf]"], f"engine=compiled with enkf: {KNOWN}"),
        (["filter=ukf", "scenario.update=stacked"], f"engine=compiled with ukf: {STACKED}"),
        (
            ["scenario=car", "filter=ghkf"],
            f"engine=compiled with ghkf: it unrolls 128 points at most, not 729{TAKE}",
        ),
    ],
)
def test_what_is_not_compiled_is_refused_in_one_line_before_anything_runs(words, said, capsys):
    assert main([*WORDS, "engine=compiled", *words]) == 2
    assert capsys.readouterr().err == f"estlab: {said}\n"
    assert not any(Path("runs").rglob("*.*"))


@pytest.mark.parametrize("name", ["ekf", "pf"])
def test_engines_agree_and_auto_is_compiled_where_it_can_be(name):
    found = {}
    several = ["filter=[ekf,pf,enkf]", "filters.pf.particles=20", "filters.enkf.members=5"]
    alone = [f"filter={name}", *(["filter.particles=20"] if name == "pf" else [])]
    for engine, words, key in (("auto", several, f"{name}.mean"), ("numpy", several, f"{name}.mean"),
                               ("compiled", alone, "mean")):  # fmt: skip
        assert main([*WORDS, *words, f"engine={engine}", f"hydra.run.dir={engine}"]) == 0
        found[engine] = np.load(Path(engine) / "estimates.npz")[key]
    assert np.array_equal(found["auto"], found["compiled"])
    np.testing.assert_allclose(found["auto"], found["numpy"], rtol=1e-11)


def test_a_second_start_compiles_nothing_and_what_is_damaged_or_changed_is_compiled_anew(tmp_path):
    source = Path(pendulum.__file__).read_text()
    model = tmp_path / "model.py"
    model.write_text(source)
    first, second = start(tmp_path), start(tmp_path)
    kept = list((tmp_path / "cache").rglob("*.o"))
    for file in kept:
        file.write_bytes(file.read_bytes()[:200])
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


def test_code_that_is_damaged_or_half_written_is_never_run(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("ESTLAB_CACHE", str(tmp_path))
    x = np.arange(4.0)[None]
    assert compiled(lambda x: (x[0] * 3.0,), 1)(x)[0].tolist() == [[0.0, 3.0, 6.0, 9.0]]
    (file,) = (tmp_path / "compiled").iterdir()
    whole = file.read_bytes()
    for damage in (b"", whole[:40], whole[:-1], whole[:-1] + b"?", b"\0" * len(whole)):
        file.write_bytes(damage)
        cache._BUILT.clear()
        assert compiled(lambda x: (x[0] * 3.0,), 1)(x)[0].tolist() == [[0.0, 3.0, 6.0, 9.0]]
        assert file.read_bytes() == whole
    assert [path.name for path in (tmp_path / "compiled").iterdir()] == [file.name]
    assert "compiled code there is damaged and is made anew" in capsys.readouterr().err
