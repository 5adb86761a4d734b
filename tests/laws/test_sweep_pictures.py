"""Pictures of sweeps, tunings and comparisons: of what is infinite, missing, constant or of many components."""

import numpy as np
import pandas as pd
import pytest

from estlab.errors import UserError
from estlab.report import overlay, sweep_plots, tuning_plots

KEY, OTHER = "filter.alpha", "noise.filter.process_scale"


def drawn(path, keys, monkeypatch, **columns) -> tuple[dict, list[str]]:
    """The figures of a sweep's table, none of them rendered, and what could not be drawn."""
    pd.DataFrame({"filter": "$a$ _b", "status": "ok"} | columns).to_csv(path / "sweep.csv", index=False)
    figures: list = []
    monkeypatch.setattr(sweep_plots, "png", lambda figure: figures.append(figure) or b"png")
    names: list[str] = []
    missing = sweep_plots.draw_all(path / "sweep.csv", "a $ title", keys, {}, lambda name, write: names.append(name))
    return dict(zip(names, figures, strict=True)), missing


@pytest.mark.parametrize("keys", [[KEY], [KEY, OTHER], []])
@pytest.mark.parametrize("last", [np.inf, np.nan, 1e300, 0.0, -1.0])
def test_a_sweep_of_which_one_value_is_no_number_is_drawn(keys, last, monkeypatch, tmp_path):
    values = {KEY: [0.1, 0.2, 0.1, 0.2], OTHER: [1.0, 1.0, 3.0, 3.0]}
    figures, missing = drawn(tmp_path, keys, monkeypatch, **values, **{"rmse.x": [1.0, 2.0, 50.0, last]})
    assert missing == []
    for axes in figures["rmse.png"].axes:
        assert np.isfinite([*axes.get_xlim(), *axes.get_ylim()]).all()


def test_a_picture_of_a_sweep_that_throws_is_missing_alone(monkeypatch, tmp_path):
    curves = sweep_plots.draw_curves

    def broken(table, columns, *rest):
        if columns == ["anees.all"]:
            raise ZeroDivisionError("one over nothing")
        return curves(table, columns, *rest)

    monkeypatch.setattr(sweep_plots, "draw_curves", broken)
    figures, missing = drawn(
        tmp_path, [KEY], monkeypatch, **{KEY: [1, 2], "anees.all": [1.0, 2.0], "rmse.x": [3.0, 4.0]}
    )
    assert set(figures) == {"rmse.png"}
    assert missing == ["missing: anees.png (ZeroDivisionError: one over nothing)"]


def test_of_forty_components_a_sweep_shows_a_few_and_all_together(monkeypatch, tmp_path):
    many = {f"rmse.x{i}": [1.0 + i, 2.0] for i in range(40)}
    figures, _ = drawn(tmp_path, [KEY], monkeypatch, **{KEY: [1, 2]}, **many, **{"rmse.all": [0.1, 0.2]})
    figure = figures["rmse.png"]
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert len(labels) == 8
    assert {"RMSE", "RMSE x39"} <= set(labels)
    assert "8 of 40" in figure.get_suptitle()


def test_a_tuning_without_an_objective_is_drawn(tmp_path):
    table = {"trial": [0, 1], "job": ["0", "1"], KEY: [0.1, 10.0], "objective": [np.inf, np.nan], "best": [np.nan] * 2}
    pd.DataFrame(table).to_csv(tmp_path / "tuning.csv", index=False)
    assert len(tuning_plots.draw(tmp_path / "tuning.csv", [KEY], "rmse.$x$").axes) == 2


def curves(label: str, rmse: list[float], anees: list[float], components=("x",)) -> overlay.Curves:
    time = np.arange(len(rmse))
    errors = pd.concat([pd.DataFrame({"time": time, "component": c, "unit": "m", "rmse": rmse}) for c in components])
    nees = pd.DataFrame({"time": time, "anees": anees, "lower": 0.5, "upper": 2.0})
    return overlay.Curves(label, "ekf", errors, nees)


def test_a_comparison_without_truth_has_no_empty_panel():
    unknown, known = curves("1  a", [np.nan] * 3, [np.nan] * 3), curves("2  b", [1.0, 2.0, 3.0], [1.0] * 3, ("y",))
    with pytest.raises(UserError, match="truth is unknown"):
        overlay.draw([unknown], [])
    panels = overlay.draw([unknown, known], []).axes
    assert [axes.get_ylabel() for axes in panels] == ["RMSE y [m]", "NEES / n"]


def test_a_row_that_is_lost_leaves_the_comparisons_panels_and_it_is_said():
    good, lost = curves("1  good", [1.0] * 9, [1.0] * 9), curves("2  lost", [1e6] * 9, [1e123] * 9)
    for axes in overlay.draw([good, lost], []).axes:
        assert axes.get_ylim()[1] < 1e4
        assert [text.get_text() for text in axes.texts] == ["beyond the panel: row 2"]


def test_a_comparison_of_forty_components_is_a_page():
    figure = overlay.draw([curves("1  a", [1.0, 2.0], [1.0, 1.0], [f"x{i}" for i in range(40)])], [])
    assert len(figure.axes) == 9
    assert figure.get_suptitle().startswith("8 of 40 components are shown")
