"""What pictures do with what is missing, infinite, constant, lost, unknown, many or oddly named. No warning comes."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from estlab import rundir
from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.space import Space
from estlab.metrics import series
from estlab.metrics.tabulated import histogram_rows
from estlab.record import Estimates, Readings, Record
from estlab.report import plots
from estlab.report.components import MOST
from estlab.report.figures import png
from tests.conftest import metrics, tallied

STEPS, RUNS = 12, 20


def space(size: int, position: int, unit: str = "m") -> Space:
    return Space(tuple(f"x{i}" for i in range(size)), (unit,) * size, position=tuple(range(position)))


class Made:
    """Tables and arrays of filters whose errors have a size of one, as a run would write them."""

    def __init__(self, space: Space, steps: int = STEPS, runs: int = RUNS, truth_known: bool = True, **change) -> None:
        """change: for a filter's name, what becomes of its mean and covariance."""
        random = np.random.default_rng(1)
        n = space.size
        path = 10.0 * random.standard_normal((n, steps, runs)).cumsum(axis=1)
        truth = path if truth_known else np.full_like(path, np.nan)
        step = np.arange(steps)
        none = np.zeros((steps, runs), dtype=int)
        readings = Readings(step, path[:1] + random.standard_normal((1, steps, runs)), none)
        prior = Gaussian(truth[:, 0], np.eye(n))
        self.space, self.runs = space, range(runs)
        self.record = Record(-1.0, 1.0 * step, truth, np.empty((0, steps, 1)), readings, prior)
        self.arrays = {"time": self.record.time, "truth": truth, "run": np.arange(runs), "places": np.empty((0, 1))}
        self.tables = {name: {} for name in (rundir.ERRORS, rundir.NEES, rundir.NIS, rundir.NOTES, rundir.HISTOGRAMS)}
        self.tallies = {}
        for name, what in (change or {"ekf": lambda mean, cov: None}).items():
            mean = path + random.standard_normal(path.shape)
            cov = np.ones((n, n, steps, runs)) * np.eye(n)[..., None, None]
            what(mean, cov)
            self._add(name, mean, cov, len(change) > 1)

    def _add(self, name: str, mean, cov, several: bool) -> None:
        white = np.random.default_rng(2).standard_normal((1, STEPS, self.record.runs))[:, : self.record.time.size]
        found = Estimates(mean, cov, white, np.zeros_like(white), None, {"ess": np.full(mean.shape[1:], 50.0)})
        problem = SimpleNamespace(space=self.space, found_within=None, lost_beyond=None)
        tally = self.tallies[name] = tallied(problem, self.record, found)
        prefix = f"{name}." if several else ""
        self.arrays |= {f"{prefix}mean": mean, f"{prefix}cov": cov}
        first = self.record.truth[..., 0], mean[..., 0], cov[..., 0]
        self.tables[rundir.ERRORS][name] = series.errors(tally, first)
        self.tables[rundir.NEES][name] = series.nees(tally)
        self.tables[rundir.NIS][name] = series.nis(tally)
        self.tables[rundir.NOTES][name] = series.notes(tally)
        self.tables[rundir.HISTOGRAMS][name] = histogram_rows(tally)

    def drawn(self, repeated: bool = False, title: str = "title", draw=lambda axes, name, place: None) -> dict:
        filters = list(self.tallies)
        data = plots.PlotData(self.tables, self.arrays, filters, self.space, title, self.runs, repeated, draw)
        made = {name: make() for name, make in plots.pictures(data).items()}
        return {name: figure for name, figure in made.items() if figure}


def from_step(step: int, value: float):
    def change(mean, cov) -> None:
        mean[:, step:] = value

    return change


def covariance(value: float):
    def change(mean, cov) -> None:
        cov *= value

    return change


def both(value: float):
    def change(mean, cov) -> None:
        mean[:] = value
        cov[:] = value

    return change


DAMAGE = {
    "nan_later": from_step(4, np.nan),
    "nan_all": both(np.nan),
    "infinite": from_step(4, np.inf),
    "infinite_all": both(np.inf),
    "huge": from_step(0, 1e200),
    "zeros": both(0.0),
    "certain": covariance(0.0),
    "no_idea": covariance(1e300),
    "below_zero": covariance(-1.0),
}
ALONE = ("nan_all", "infinite_all", "huge", "zeros", "below_zero")


def sound(figures: dict) -> None:
    assert figures
    for figure in figures.values():
        for axes in figure.axes:
            assert np.isfinite([*axes.get_xlim(), *axes.get_ylim()]).all()


@pytest.mark.parametrize("damage", DAMAGE)
def test_damaged_estimates_are_drawn_alone_and_beside_a_sound_filter(damage):
    if damage in ALONE:
        sound(Made(space(2, 2), ekf=DAMAGE[damage]).drawn(repeated=True))
    else:
        sound(Made(space(2, 2), ekf=DAMAGE[damage], ukf=covariance(1.0)).drawn())


@pytest.mark.parametrize("position", [0, 1, 2, 3, 4])
def test_a_position_of_any_size_is_drawn(position):
    drawn = Made(space(4, position), ekf=DAMAGE["nan_later"], pf=covariance(1.0)).drawn(repeated=True)
    sound(drawn)
    assert ("trajectory.png" in drawn) == (position > 0)


@pytest.mark.parametrize("size", [{"steps": 2}, {"steps": 2, "runs": 1}, {"truth_known": False}])
def test_little_data_is_drawn(size):
    sound(Made(space(2, 2), **size).drawn(repeated=True))
    sound(Made(space(1, 0), **size, ekf=both(0.0)).drawn(repeated=True))


def test_a_single_step_has_no_picture():
    assert Made(space(2, 2), steps=1).drawn() == {}


def test_one_component_is_drawn_over_time_and_three_in_two_views():
    line = Made(space(2, 1)).drawn()["trajectory.png"].axes
    assert [axes.get_xlabel() for axes in line] == ["time [s]"]
    assert line[0].get_ylabel() == "x0 [m]"
    views = Made(space(4, 3)).drawn()["trajectory.png"].axes
    assert [(axes.get_xlabel(), axes.get_ylabel()) for axes in views] == [("x0 [m]", "x1 [m]"), ("x0 [m]", "x2 [m]")]
    made = Made(space(4, 3))
    truth = made.drawn()["trajectory.png"].axes[1].get_lines()[0]
    np.testing.assert_array_equal(truth.get_ydata(), made.arrays["truth"][2, :, 0])


def test_a_state_of_forty_is_a_page_with_all_of_it_in_one_picture():
    def worse(mean, cov) -> None:
        mean[33] += 9.0

    made = Made(space(40, 0), ekf=worse)
    drawn = made.drawn()
    errors = drawn["errors.png"]
    assert len(errors.axes) == MOST
    assert "8 of 40 components are shown" in errors.get_suptitle().replace("\n", " ")
    assert {"x0 [m]", "x33 [m]"} <= {axes.get_ylabel() for axes in errors.axes}
    assert errors.get_size_inches()[1] < 16.0
    (axes,) = drawn["components.png"].axes
    rmse = axes.get_lines()[0].get_ydata()
    assert rmse.shape == (40,)
    assert np.argmax(rmse) == 33
    rows = metrics(made.tallies["ekf"])
    each = [rows["rmse", f"x{i}"].value ** 2 for i in range(40)]
    assert rows["rmse", "all"].value == pytest.approx(np.sqrt(np.mean(each)), rel=1e-12)
    assert rows["rmse", "all"].unit == "m"


def test_components_of_unlike_units_have_no_error_over_all():
    mixed = Space(tuple(f"x{i}" for i in range(10)), ("m",) * 9 + ("rad",))
    assert ("rmse", "all") not in metrics(Made(mixed).tallies["ekf"])
    assert ("rmse", "all") not in metrics(Made(space(3, 0)).tallies["ekf"])


def notes(axes) -> str:
    return " ".join(text.get_text() for text in axes.texts)


def test_a_filter_that_is_far_off_leaves_the_panel_and_it_is_said():
    alone = Made(space(2, 2)).drawn()
    beside = Made(space(2, 2), ekf=covariance(1.0), dead_reckoning=covariance(1e4)).drawn()
    for axes, held in zip(beside["errors.png"].axes, alone["errors.png"].axes, strict=True):
        assert axes.get_ylim()[1] == pytest.approx(held.get_ylim()[1], rel=0.5)
        assert notes(axes) == "beyond the panel: dead_reckoning (±3e+02)"


@pytest.mark.parametrize("truth_known", [True, False])
def test_every_panel_has_the_scale_of_the_filter_that_holds_best(truth_known):
    def wide(mean, cov) -> None:
        mean[0] += 4.0  # as wide as four times the best, in one component alone twice
        cov *= np.array([16.0, 4.0])[:, None, None, None]

    alone = Made(space(2, 2), truth_known=truth_known).drawn()["errors.png"].axes
    beside = Made(space(2, 2), ekf=covariance(1.0), dead_reckoning=wide, truth_known=truth_known)
    far, near = beside.drawn()["errors.png"].axes
    spans = [
        np.diff(axes.get_ylim())[0] / np.diff(held.get_ylim())[0] for axes, held in zip((far, near), alone, strict=True)
    ]
    assert spans[0] == pytest.approx(1.0, rel=0.05)
    assert notes(far) == "beyond the panel: dead_reckoning (±12)"
    assert 1.0 < spans[1] < 2.1
    assert notes(near) == ""


def test_an_error_of_an_angle_is_drawn_to_half_a_turn_and_its_band_cut():
    turning = Space(("heading",), ("rad",), angles=(0,))
    (axes,) = Made(turning, dead_reckoning=covariance(9.0)).drawn()["errors.png"].axes
    assert axes.get_ylim()[1] == pytest.approx(1.25 * np.pi)
    assert notes(axes) == "beyond the panel: dead_reckoning (±9)"


def test_a_nees_without_bounds_leaves_its_axis_and_it_is_said():
    drawn = Made(space(2, 2), ekf=covariance(1.0), pf=covariance(1e-120)).drawn()
    (axes,) = drawn["nees.png"].axes
    assert axes.get_ylim()[1] < 100.0
    assert notes(axes).startswith("beyond the panel: pf (to ")
    (alone,) = Made(space(2, 2), pf=covariance(1e-120)).drawn()["nees.png"].axes
    assert alone.get_ylim()[1] <= 1e4


def test_an_ellipse_larger_than_the_picture_is_left_out_and_counted():
    def uniform_prior(mean, cov) -> None:
        cov[:, :, 0] *= 1e6

    (axes,) = Made(space(2, 2), pf=uniform_prior).drawn()["trajectory.png"].axes
    whole = Made(space(2, 2)).drawn()["trajectory.png"].axes[0]
    assert len(axes.get_lines()) == len(whole.get_lines()) - 1
    assert "3 sigma of the position (1 too large to draw)" in axes.get_legend_handles_labels()[1]


def test_a_filter_that_is_lost_beside_a_sound_one_sets_no_scale():
    """Neither its path nor its ellipses, which may be small and far away."""
    for position in (1, 2):
        made = Made(space(2, position), ekf=lambda mean, cov: None, pf=from_step(4, 7e5))
        (axes,) = made.drawn()["trajectory.png"].axes
        assert np.abs([*axes.get_xlim(), *axes.get_ylim()]).max() < 1000.0


def test_without_truth_estimates_are_drawn_and_no_panel_is_empty():
    made = Made(space(2, 2), truth_known=False)
    drawn = made.drawn()
    assert set(drawn) == {"errors.png", "nis.png", "ess.png", "trajectory.png"}
    for i, axes in enumerate(drawn["errors.png"].axes):
        line = next(line for line in axes.get_lines() if "estimate" in line.get_label())
        np.testing.assert_array_equal(line.get_ydata(), made.arrays["mean"][i, :, 0])
        assert "truth unknown" in line.get_label()


NAMES = ("$a$ and $", "_hidden", "位置\x07", "long " * 40, r"\frac{", "#%&~^")


def test_names_of_any_letters_are_drawn_without_a_warning():
    odd = Space(NAMES, ("位", "$", "", "m", "m", "m"), position=(0, 1))
    drawn = Made(odd, **{NAMES[0]: covariance(1.0), NAMES[1]: covariance(1.0)}).drawn(title=" ".join(NAMES) * 9)
    for name in ("errors.png", "trajectory.png"):
        assert png(drawn[name]).startswith(b"\x89PNG")
    labels = drawn["errors.png"].axes[0].get_legend_handles_labels()[1]
    assert sum("hidden" in label for label in labels) == 1


def with_cloud(made: Made, name: str, several: bool) -> Made:
    """Clouds about the means: of 30 particles at 6 steps."""
    prefix = f"{name}." if several else ""
    steps = np.array([0, 1, 3, 5, 8, 11])
    spread = np.random.default_rng(3).standard_normal((2, 6, 30, RUNS))
    points = made.arrays[f"{prefix}mean"][:, steps][:, :, None] + spread
    weights = np.full((6, 30, RUNS), 1.0 / 30.0)
    made.arrays |= {f"{prefix}cloud.{key}": a for key, a in (("step", steps), ("points", points), ("weights", weights))}
    return made


@pytest.mark.parametrize("several", [False, True])
def test_clouds_are_of_the_best_and_the_worst_run_at_six_moments(several):
    def one_lost(mean, cov) -> None:
        mean[..., 13] += 500.0

    others = {"ekf": covariance(1.0)} if several else {}
    made = with_cloud(Made(space(2, 2), pf=one_lost, **others), "pf", several)
    places = []
    figure = made.drawn(draw=lambda axes, name, place: places.append(place))["cloud_pf.png" if several else "cloud.png"]
    best, worst = (part.get_suptitle() for part in figure.subfigs)
    assert "the best of 20 kept" in best
    assert worst.startswith("run 13, the worst of 20 kept, RMSE 70")
    assert [axes.get_title() for axes in figure.subfigs[0].axes] == ["0 s", "1 s", "3 s", "5 s", "8 s", "11 s"]
    assert places.count(13) == 6
    sound({"cloud": figure})


def test_runs_over_one_recording_are_beside_each_other():
    made = Made(space(2, 2), truth_known=True)
    left, right = made.drawn(repeated=True)["repeats.png"].axes
    assert len(left.get_lines()) == 1 + RUNS
    off = np.hypot(*(made.arrays["mean"] - made.arrays["truth"][..., :1]))
    np.testing.assert_allclose([line.get_ydata() for line in right.get_lines()], off.T, rtol=1e-12)
    assert "repeats.png" not in made.drawn(repeated=False)


def test_an_rmse_of_all_runs_that_the_first_run_is_far_from_is_seen_or_said():
    def others(factor: float):
        def change(mean, cov) -> None:
            mean[0, :, 1:] += factor

        return change

    near, _ = Made(space(2, 2), pf=others(6.0)).drawn()["errors.png"].axes
    assert near.get_ylim()[1] > 6.0
    assert notes(near) == ""
    far, beside = Made(space(2, 2), pf=others(60.0)).drawn()["errors.png"].axes
    assert far.get_ylim()[1] == pytest.approx(beside.get_ylim()[1], rel=0.2)
    assert re.fullmatch(rf"beyond the panel: RMSE of {RUNS} runs \(±\d+\)", notes(far))


def test_a_statistic_without_a_law_has_no_band_in_its_picture():
    made = Made(space(2, 2), pf=covariance(1.0))
    labels = [text.get_text() for text in made.drawn()["nees.png"].legends[0].get_texts()]
    assert "95 % of a consistent filter" in labels
    for bound in ("lower", "upper"):
        made.tables[rundir.NEES]["pf"][bound] = np.full_like(made.tables[rundir.NEES]["pf"][bound], np.nan)
    labels = [text.get_text() for text in made.drawn()["nees.png"].legends[0].get_texts()]
    assert [label for label in labels if "95 %" in label] == []
    assert len(labels) == 1


def test_a_filter_has_one_colour_in_every_picture_of_a_run_whichever_filters_are_in_it():
    made = Made(space(2, 2), ekf=covariance(1.0), mine=covariance(1.0), pf=covariance(1.0))
    made.tables[rundir.NOTES] = {"pf": made.tables[rundir.NOTES]["pf"]}
    drawn = made.drawn()
    (size,) = drawn["ess.png"].axes[0].get_lines()
    for name in ("errors.png", "trajectory.png"):
        lines = {
            line.get_label().partition(", ")[2] or line.get_label(): line for line in drawn[name].axes[0].get_lines()
        }
        found = {label: line.get_color() for label, line in lines.items()}
        assert next(colour for label, colour in found.items() if label.startswith("pf")) == size.get_color()
        assert len({colour for label, colour in found.items() if label.startswith(("ekf", "mine", "pf"))}) == 3
