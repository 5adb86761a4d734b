"""Normal numbers that compiled code draws, against the streams of NumPy, to the last bit."""

import numpy as np
import pytest

from estlab.compiled import normals as drawn
from estlab.maths.streams import Streams

TAIL = 3.6541528853610088  # beyond which a number takes logarithms


@pytest.mark.parametrize("lanes", [1, 2, 4, 8])
def test_numbers_of_compiled_code_are_numpys_to_the_last_bit(lanes):
    edges = np.array([0, 30_000, 30_000, 30_003, 90_000, 120_001])
    runs, streams = [0, 3, 7, 2**31, 2**32 + 5], Streams(11, "test")
    code = drawn.Normals(lanes)
    found = drawn.one_after_another(code, streams, "readings", runs, edges, room=3)
    by_numpy = drawn.one_after_another(None, streams, "readings", runs, edges, room=3)
    np.testing.assert_array_equal(found, by_numpy)
    assert (np.abs(found) > TAIL).sum() > 20
    assert (found[-3:] == 0.0).all()


def test_streams_are_drawn_by_compiled_code_where_that_pays(monkeypatch):
    streams, shape = Streams(4, "car"), (5, 2)
    wanted = streams.normals("truth", range(6), shape)
    asked = []
    monkeypatch.setattr(drawn, "code", lambda: asked.append(1) or drawn.Normals(1))
    for many, times in ((61, 0), (60, 1)):
        monkeypatch.setattr(drawn, "_MANY", many)
        np.testing.assert_array_equal(drawn.normals(streams, "truth", range(6), shape), wanted)
        assert len(asked) == times


def test_other_numbers_than_numpys_are_not_taken(monkeypatch, caplog):
    table = drawn.numpy_streams.layers()
    monkeypatch.setattr(drawn.numpy_streams, "layers", lambda: table * np.array([1.0, 1.0 + 1e-15, 1.0, 1.0]))
    drawn.code.cache_clear()
    try:
        with caplog.at_level("INFO", logger="estlab"):
            assert drawn.code() is None
        assert "NumPy draws the normal numbers" in caplog.text
    finally:
        drawn.code.cache_clear()


@pytest.mark.parametrize("what", ["memory", "library"])
def test_where_no_compiler_can_be_loaded_numpy_draws(monkeypatch, what):
    def fails():
        raise OSError("no such library")

    if what == "memory":
        monkeypatch.setattr(drawn.machine_code.resource, "getrlimit", lambda which: (2**28, 2**28))
    else:
        monkeypatch.setattr(drawn.machine_code, "_machine", fails)
    assert not drawn.machine_code.loadable()
    monkeypatch.setattr(drawn, "_MANY", 0)
    drawn.code.cache_clear()
    try:
        streams = Streams(4, "car")
        wanted = streams.normals("truth", range(3), (5, 2))
        np.testing.assert_array_equal(drawn.normals(streams, "truth", range(3), (5, 2)), wanted)
    finally:
        drawn.code.cache_clear()
