"""A filter over arrays of a person's own, against a textbook loop that knows nothing of estlab."""

import numpy as np
import pytest

import estlab
from estlab import Gaussian, Motion, Sensor, Space, Uniform
from estlab.config.build import build
from estlab.maths.streams import Streams

DT, STEPS = 0.1, 60
A = np.array([[1.0, DT], [0.0, 1.0]])
B = np.array([[0.5 * DT**2], [DT]])
H = np.array([[1.0, 0.0], [1.0, 0.2]])
Q, R = np.array([[2.0]]), np.array([[0.3, 0.1], [0.1, 0.5]])
P0 = np.array([[4.0, 0.5], [0.5, 1.0]])
STATE, READING = Space(("place", "speed"), ("m", "m/s")), Space(("near", "far"), ("m", "m"))
TIME = DT * np.arange(1, STEPS + 1)


def move(state, control, noise, dt):
    push = control[0] + noise[0]
    return state[0] + dt * state[1] + 0.5 * dt**2 * push, state[1] + dt * push


def measure(state, landmark):
    return state[0], state[0] + 0.2 * state[1]


MOTION = Motion(STATE, move, lambda control, dt: Q, 1)
SENSOR = Sensor(READING, STATE, measure, R)
PRIOR = Gaussian(np.array([1.0, -1.0]), P0)
rng = np.random.default_rng(3)
CONTROL = rng.standard_normal((1, STEPS))
READINGS = np.empty((2, STEPS))
truth = np.array([0.0, -0.5])
for k in range(STEPS):
    truth = A @ truth + B[:, 0] * (CONTROL[0, k] + np.sqrt(2.0) * rng.standard_normal())
    READINGS[:, k] = H @ truth + np.linalg.cholesky(R) @ rng.standard_normal(2)
READINGS[:, 10:13] = np.nan
LINEAR = ("ekf", "iekf", "second_order", "ukf", "ckf", "ghkf", "srukf", "srckf")


def textbook(readings, first=True):
    """The Kalman filter as a book prints it: means (2, T), covariances (2, 2, T), NIS (T,)."""
    x, p = PRIOR.mean, P0
    means, covs, nis = [], [], []
    for k in range(readings.shape[1]):
        if first or k > 0:
            x = A @ x + B[:, 0] * CONTROL[0, k]
            p = A @ p @ A.T + B @ Q @ B.T
        z = readings[:, k]
        nis.append(np.nan)
        if not np.isnan(z).any():
            innovation = z - H @ x
            s = H @ p @ H.T + R
            gain = p @ H.T @ np.linalg.inv(s)
            x = x + gain @ innovation
            p = (np.eye(2) - gain @ H) @ p
            nis[-1] = innovation @ np.linalg.inv(s) @ innovation
        means.append(x)
        covs.append(p)
    return np.array(means).T, np.moveaxis(np.array(covs), 0, -1), np.array(nis)


@pytest.mark.parametrize("engine", ["numpy", "auto"])
@pytest.mark.parametrize("name", LINEAR)
def test_on_a_linear_problem_every_filter_is_the_textbook_s(name, engine):
    found = estlab.estimate(name, MOTION, SENSOR, PRIOR, TIME, READINGS, CONTROL, start=0.0, engine=engine)
    mean, cov, nis = textbook(READINGS)
    np.testing.assert_allclose(found.mean, mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.cov, cov, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.nis, nis, rtol=1e-9)


def test_without_a_start_the_first_reading_meets_the_prior_itself():
    found = estlab.estimate("ekf", MOTION, SENSOR, PRIOR, TIME, READINGS, CONTROL)
    np.testing.assert_allclose(found.mean, textbook(READINGS, first=False)[0], atol=1e-9)


def test_step_by_step_gives_what_the_whole_gives():
    filter, belief = estlab.make_filter("ukf"), PRIOR
    whole = estlab.estimate(filter, MOTION, SENSOR, PRIOR, TIME, READINGS, CONTROL, start=0.0, engine="numpy")
    for k in range(STEPS):
        belief = filter.predict(MOTION, belief, CONTROL[:, k], TIME[k] - (TIME[k - 1] if k else 0.0))
        if not np.isnan(READINGS[:, k]).any():
            belief, _ = filter.update(SENSOR, belief, READINGS[:, k], SENSOR.landmark(0))
        np.testing.assert_array_equal(belief.mean, whole.mean[:, k])
        np.testing.assert_array_equal(belief.cov, whole.cov[..., k])


def test_runs_go_through_together_as_each_alone():
    many = np.stack([READINGS, READINGS + 1.0, 2.0 * READINGS], axis=2)
    together = estlab.estimate("ukf", MOTION, SENSOR, PRIOR, TIME, many, CONTROL, start=0.0)
    assert together.mean.shape == (2, STEPS, 3)
    for run in range(3):
        alone = estlab.estimate("ukf", MOTION, SENSOR, PRIOR, TIME, many[..., run], CONTROL, start=0.0)
        np.testing.assert_array_equal(together.mean[..., run], alone.mean)
        np.testing.assert_array_equal(together.nis[:, run], alone.nis)


@pytest.mark.parametrize(("name", "settings"), [("pf", {"particles": 20_000}), ("enkf", {"members": 2_000})])
def test_sampled_filters_come_near_the_textbook_and_repeat_by_their_seed(name, settings):
    filter = estlab.make_filter(name, **settings)
    runs = [
        estlab.estimate(filter, MOTION, SENSOR, PRIOR, TIME, READINGS, CONTROL, start=0.0, seed=seed)
        for seed in (1, 1, 2)
    ]
    np.testing.assert_array_equal(runs[0].mean, runs[1].mean)
    assert not np.array_equal(runs[0].mean, runs[2].mean)
    off = (runs[0].mean - textbook(READINGS)[0]) / runs[0].sd
    assert np.abs(off).max() < 0.5


def test_the_smoother_ends_where_the_filter_does_and_is_surer_before():
    filtered, smoothed = (
        estlab.estimate("ekf", MOTION, SENSOR, PRIOR, TIME, READINGS, CONTROL, start=0.0, smooth=smooth)
        for smooth in (False, True)
    )
    np.testing.assert_allclose(smoothed.mean[:, -1], filtered.mean[:, -1], rtol=1e-12)
    assert (smoothed.sd[:, :-1] < filtered.sd[:, :-1]).all()


def test_a_truth_gives_errors_the_short_way_round():
    heading = Space(("heading",), ("rad",), angles=(0,))
    motion = Motion(heading, lambda state, control, noise, dt: (state[0] + noise[0],), lambda control, dt: np.eye(1), 1)
    compass = Sensor(heading, heading, lambda state, landmark: (state[0],), np.array([[1e-4]]))
    prior = Gaussian(np.array([3.1]), np.eye(1))
    truth = np.full((1, 5), 3.14)
    found = estlab.estimate("ekf", motion, compass, prior, np.arange(5.0), truth + 0.01, truth=truth)
    assert np.abs(found["heading"].error).max() < 0.02
    assert found["heading"].mean[-1] < -3.1


def test_a_uniform_prior_and_landmarks_by_number():
    sensor = Sensor(
        Space(("distance",), ("m",)),
        STATE,
        lambda state, landmark: (landmark[0] - state[0],),
        np.array([[0.01]]),
        np.array([[10.0, 20.0]]),
    )
    about = np.arange(STEPS) % 2
    readings = np.where(about == 0, 10.0, 20.0)[None] - 4.0
    prior = Uniform(np.array([0.0, -0.1]), np.array([8.0, 0.1]), 1)
    found = estlab.estimate("ukf", MOTION, sensor, prior, TIME, readings, 0.0 * CONTROL, landmark=about)
    assert found["place"].mean[-1] == pytest.approx(4.0, abs=0.1)


@pytest.mark.slow
def test_a_scenario_s_own_run_is_what_estimate_makes_of_its_record(folder):
    run = estlab.load(folder)
    settings = build(run.config)
    scenario, assumed = settings.scenario, settings.noise.filter
    record = scenario.simulate(Streams(settings.seed, "landmark"), range(3), settings.noise.truth).first(25)
    # Several readings of a step are as many times that are equal.
    count = np.bincount(record.readings.step, minlength=record.time.size)
    own = np.repeat(np.arange(record.time.size), np.maximum(count, 1))
    read = np.flatnonzero(np.repeat(count > 0, np.maximum(count, 1)))
    values, about = np.full((2, own.size, 3), np.nan), np.zeros((own.size, 3), dtype=int)
    values[:, read], about[read] = record.readings.values, record.readings.landmark_number
    found = estlab.estimate(
        "ekf",
        scenario.motion(assumed),
        scenario.sensor(assumed, record.landmarks),
        record.prior,
        record.time[own],
        values,
        record.control[:, own],
        start=record.start,
        landmark=about,
    )
    last = np.append(np.diff(own) > 0, True)
    np.testing.assert_array_equal(found.mean[:, last], run.estimates["ekf"].mean)
    np.testing.assert_array_equal(found.cov[:, :, last], run.estimates["ekf"].cov)


WRONG = {
    "readings has the shape (60, 2); must be (2, 60): m = 2 components of the sensor, then time; it is transposed, "
    "write readings.T": {"readings": READINGS.T},
    "readings has the shape (2, 50); must be (2, 60)": {"readings": READINGS[:, :50]},
    "readings must be an array of numbers": {"readings": [["a"]]},
    "control has the shape (60, 1); must be (c, 60) or (c, 60, 1); it is transposed": {"control": CONTROL.T},
    "time has the shape (1, 60); must be (T,)": {"time": TIME[None]},
    "time goes back from 6 at step 0 to 5.9; it must ascend": {"time": TIME[::-1]},
    "prior is a tuple; must be an estlab.Gaussian or an estlab.Uniform": {"prior": (1.0, 2.0)},
    "prior has the shapes (3,) and (2, 2); must be (2,) and (2, 2)": {"prior": Gaussian(np.zeros(3), P0)},
    "a covariance must be positive semidefinite": {"prior": Gaussian(PRIOR.mean, -P0)},
    "start is 5, after time[0] = 0.1": {"start": 5.0},
    "landmark has the shape (3,) and the type int64; must be (60,)": {"landmark": np.arange(3)},
    "truth has the shape (2, 3); must be (2, 60): n = 2 components of the state": {"truth": np.zeros((2, 3))},
    "there is no filter ukff; did you mean ukf?": {"filter": "ukff"},
    "filter: is the number 3; must be a Filter": {"filter": 3},
    "motion: is a Sensor; must be a Motion": {"motion": SENSOR},
    "motion: move returned the number 1.0; must be a tuple of 2 components": {
        "motion": Motion(STATE, lambda state, control, noise, dt: 1.0, lambda control, dt: Q, 1)
    },
    "smoother": {"filter": "pf", "smooth": True},
    "engine must be one of auto, numpy, compiled, got 'fast'": {"engine": "fast"},
}


@pytest.mark.parametrize("message", WRONG)
def test_what_is_wrong_with_an_argument_is_one_line(message):
    given = {
        **{"filter": "ekf", "motion": MOTION, "sensor": SENSOR, "prior": PRIOR, "time": TIME, "readings": READINGS},
        **{"control": CONTROL},
    }
    with pytest.raises(estlab.UserError) as error:
        estlab.estimate(**(given | WRONG[message]))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_estimates_become_an_xarray_dataset_with_named_dimensions():
    pytest.importorskip("xarray")
    many = np.stack([READINGS, READINGS], axis=2)
    found = estlab.estimate("ekf", MOTION, SENSOR, PRIOR, TIME, many, CONTROL)
    dataset = found.to_xarray()
    np.testing.assert_array_equal(dataset["mean"].sel(component="speed", run=1), found["speed"].mean[:, 1])
    np.testing.assert_array_equal(dataset["cov"].sel(component="place", component_="speed"), found.cov[0, 1])
    assert dataset["nis"].dims == ("time", "run")
    assert str(dataset["unit"].sel(component="speed").item()) == "m/s"
