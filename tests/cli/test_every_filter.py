"""Every problem, shipped and of plugins, through every filter, alone and as an ensemble, with pictures and page."""

from dataclasses import replace
from functools import cache
from itertools import cycle

import pytest
from matplotlib.figure import Figure

from estlab.errors import UserError
from estlab.experiment.compatibility import check
from estlab.launch.execute import Request, execute
from estlab.rundir import RunDirectory
from tests.conftest import options, settings
from tests.plugins import plugged

pytestmark = pytest.mark.slow

SCENARIOS = [*options("scenario"), *plugged.NAMES]
SMALL = {"pf": "particles=150", "apf": "particles=150", "rpf": "particles=150", "enkf": "members=50", "ghkf": "order=2"}
FAMILIES = ("dead_reckoning", "ekf", "srukf", "enkf", "pf")
# Each problem's pictures of one run are of one filter; the next problem's of the next family.
ALONE = dict(zip(SCENARIOS, cycle(("pf", "ukf", "enkf", "srukf", "rpf")), strict=False))


@cache
def filters():
    """All that there are, the costly ones small."""
    words = [f"+filter@filters.{name}={name}" for name in options("filter")]
    return settings(*words, *(f"filters.{name}.{small}" for name, small in SMALL.items())).filters


@cache
def problem(scenario):
    """A few steps of it."""
    words = ["runs=20", f"steps={2 if scenario == 'lorenz96' else 8}", "filter=ekf", "cores=1"]
    return plugged.settings(scenario, *words) if scenario in plugged.NAMES else settings(f"scenario={scenario}", *words)


def ends_well(chosen, folder, capsys):
    """Run it, and see that nothing is missing and nothing was complained of."""
    request = Request({"report": chosen.plots}, chosen.names, "", "", ["estlab", "run"])
    code = execute(request, RunDirectory(folder), chosen)
    said = capsys.readouterr()
    assert (code, said.err) == (0, "")
    assert "missing" not in said.out


def taken(base, scenario, capsys):
    """The filters that are not refused."""
    found = {}
    for name, filter in filters().items():
        try:
            check(replace(base, filters={name: filter}))
            found[name] = filter
        except UserError as error:
            assert str(error).startswith("filter."), error
            assert "\n" not in str(error)
    return found


@pytest.mark.parametrize("runs", [1, 20])
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_every_filter_runs_or_is_refused_in_one_line(scenario, runs, tmp_path, capsys):
    base = replace(problem(scenario), runs=runs, plots=False)
    chosen = taken(base, scenario, capsys)
    assert set(filters()) - set(chosen) <= {"ghkf"}
    ends_well(replace(base, filters=chosen), tmp_path / "run", capsys)


@pytest.mark.parametrize("runs", [1, 20])
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_pictures_and_page_are_whole(scenario, runs, tmp_path, capsys, monkeypatch):
    """Of a filter alone in one run, and of one of each family in twenty, without the time that a layout takes."""
    monkeypatch.setattr(Figure, "set_layout_engine", lambda self, layout=None, **more: None)
    names = [ALONE[scenario]] if runs == 1 else FAMILIES
    chosen = {name: filters()[name] for name in names}
    base = replace(problem(scenario), runs=runs, plots=True)
    ends_well(replace(base, filters=chosen), tmp_path / "run", capsys)
    assert (tmp_path / "run/report.html").stat().st_size > 10_000
    for picture in (tmp_path / "run/plots").iterdir():
        assert picture.read_bytes().startswith(b"\x89PNG"), picture
    assert list((tmp_path / "run/plots").iterdir())
