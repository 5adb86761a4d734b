"""The slips of somebody who writes a model, a record or a filter: each is one line that names function and field."""

import re
import types
from dataclasses import dataclass, replace

import numpy as np
import pytest

from estlab.config.settings import Names
from estlab.errors import AnswerError
from estlab.experiment.monte_carlo import check_answers, loop_of, record_of
from estlab.filters.filter import Innovation
from estlab.filters.gaussian import GaussianFilter
from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.transforms import Linearised
from tests.cli.test_readme import block
from tests.conftest import options, settings
from tests.plugins import plugged

SOURCE = "import math\nfrom dataclasses import replace\nfrom estlab.maths.space import wrap\n" + block("pendulum.py")
MOVED = "return angle + dt * faster, faster"
READ = "return (np.sin(angle),)"
Q = "np.array([[variance / dt]]), 1)"
R = "np.array([[variance]])"
PRIOR = "np.diag([0.1**2, 0.1**2])"
DRAWN = "return drawn(streams, runs, self.motion(noise), sensor, prior, time, np.empty((0, time.size, 1)))"
WITH = DRAWN.replace("return ", "record = ") + "\n        readings = record.readings\n        return "
RIGHT = "((1.0 - dt * dt * 9.81 * np.cos(s[0]), dt), (-dt * 9.81 * np.cos(s[0]), 1.0))"

MOTIONS = [
    (MOVED, "return angle + dt * faster", "move (swing) returned the number"),
    (MOVED, "return angle, faster, 0.0",
     "move (swing) returned 3 components; must be a tuple of 2 components (angle, rate)"),
    (MOVED, "pass",
     "move (swing) returned nothing (None); must be a tuple of 2 components (angle, rate); is a return missing?"),
    (MOVED, "return [angle], faster", "move (swing) returned for angle an array (1,) where its arguments have ()"),
    (MOVED, "return angle, 'fast'", "move (swing) returned for rate a str; must be a number or an array"),
    (MOVED, "return wrap(angle + dt * faster), faster", "move (swing) wraps angle; return it unrolled"),
    (MOVED, "state[0] += dt * faster; return state[0], faster", "move (swing) changed its arguments in place"),
    (MOVED, "return angle, rate + np.max(angle)", "move (swing) gives rate = "),
    (MOVED, "return angle, np.log(angle - 5.0)", "move (swing) returned nan for rate at the start, angle="),
    (Q, "[[variance / dt]], 1)", "noise_cov returned a list of 1; must be an array (1, 1)"),
    (Q, "variance / dt, 1)", "noise_cov returned the number"),
    (Q, "np.array([variance / dt]), 1)", "noise_cov returned an array (1,); must be an array (1, 1)"),
    (Q, "np.array([[-variance]]), 1)", "noise_cov returned a matrix with the variance -0.04; a covariance must be"),
    (Q, "np.array([[np.nan]]), 1)", "noise_cov returned nan at [0, 0]; must be finite"),
    (Q, "np.eye(2), 1)", "noise_cov returned an array (2, 2); must be an array (1, 1)"),
    (Q, "np.array([[1, 'a']]), 1)", "noise_cov returned an array (1, 2) of <U"),
    (Q, "np.eye(1), '1')", "noise_size = '1'; must be an integer"),
    (Q, f"{Q[:-1]}, lambda s, c, dt: ((1.0, dt), (0.0, 1.0)))", "jacobians returned for dx/dx the number 1.0 as row 0"),
    (Q, f"{Q[:-1]}, lambda s, c, dt: (((1.0, dt), (0.0, 1.0)), ((dt * dt,), (dt,))))",
     "jacobians: the derivative of angle in angle is stated as 1 and is 0.99"),
    (Q, f"{Q[:-1]}, lambda s, c, dt: ({RIGHT}, ((0.0,), (dt,))))",
     "jacobians: the derivative of angle in noise 0 is stated as 0 and is 0.0004 by differences"),
    (Q, f"{Q[:-1]}, lambda s, c, dt: ({RIGHT}, ((0.0, 0.0), (dt, 0.0))))",
     "jacobians returned for dx/dw 2 entries in row 0; must be 2 rows of 1"),
    (Q, f"{Q[:-1]}, lambda s, c, dt: {RIGHT}[0])", "jacobians returned for dx/dx the number"),
    (Q, f"{Q[:-1]}, None, lambda s, c, dt: ())", "hessians must return a matrix (2 by 2) for each of 2 components"),
    ("return Motion(STATE", "Motion(STATE", "returned nothing (None); must be a Motion; is a return missing?"),
]  # fmt: skip

SENSORS = [
    (READ, "return np.sin(angle)", "measure (sideways) returned the number"),
    (READ, "return (np.sin(angle), rate)",
     "measure (sideways) returned 2 components; must be a tuple of 1 component (sideways)"),
    (READ, "pass", "measure (sideways) returned nothing (None)"),
    (READ, "return (np.sin(angle) * np.nan,)", "measure (sideways) returned nan for sideways"),
    (READ, "return (np.linalg.norm(state),)", "measure (sideways) gives sideways = "),
    (R, "np.array([0.01])", "noise_cov is an array (1,); must be an array (1, 1)"),
    (R, "0.01", "noise_cov is the number 0.01; must be an array (1, 1)"),
    (R, "np.array([[-1.0]])", "noise_cov is a matrix with the variance -1"),
    (R, "np.array([[0.0]])", "noise_cov is singular: sideways has no noise of its own"),
    (f"STATE, sideways, {R}, landmarks", f"STATE, sideways, {R}, None", "landmarks must be an array (p, number"),
    ("Sensor(READING, STATE", "Sensor(STATE, READING", "state is that of ('sideways',); must be the scenario's"),
    (f"{R}, landmarks)", f"{R}, landmarks, lambda s, p: ((np.cos(s[0]),),))",
     "jacobian returned 1 entries in row 0; must be 1 row of 2"),
    (f"{R}, landmarks)", f"{R}, landmarks, lambda s, p: ((-np.cos(s[0]), 0.0),))",
     "jacobian: the derivative of sideways in angle is stated as -0.4"),
    (f"{R}, landmarks)", f"{R}, landmarks, 'cos')", "jacobian = 'cos'; must be a function, or None"),
]  # fmt: skip

SPACES = [
    ('("rad", "rad/s")', '("rad",)', "2 names and 1 units"),
    ('("angle", "rate")', '("angle", "angle")', "each component needs its own name"),
    ('("angle", "rate")', '"ar"', "names = 'ar'; must be a tuple of words"),
    ("angles=(0,)", "angles=(2,)", "angles = (2,); must be a tuple of indices of components, from 0 to 1"),
    ("angles=(0,)", "angles=0", "angles = 0; must be a tuple of indices of components"),
    ("        return STATE", "        return None", "is nothing (None); must be a Space"),
]

RECORDS = [
    (PRIOR, "np.array([0.1**2, 0.1**2])", "prior.cov is an array (2,); must be an array (2, 2)"),
    (PRIOR, "np.array([[0.1, 0.2], [0.3, 0.1]])", "prior.cov is 0.2 at [0, 1] and 0.3 at [1, 0]; must be symmetric"),
    (PRIOR, "np.array([[0.1, 0.2], [0.2, 0.1]])", "prior.cov is a matrix with the eigenvalue -0.1"),
    ("np.array([1.0, 0.0])", "np.array([1.0, 0.0, 2.0])", "prior.mean is an array (3,); must be an array (2,)"),
    ("np.empty((0, time.size, 1))", "np.empty((0, time.size))",
     "control is an array (0, 30); must be an array (c, 30, 3 or 1)"),
    ("np.empty((0, time.size, 1))", "np.full((1, time.size, 1), np.nan)",
     "control is nan at [0, 0, 0]; must be finite"),
    ("np.empty((0, time.size, 1))", "np.empty((0, 5, 1))",
     "control is an array (0, 5, 1); must be an array (0, 30, 3)"),
    (DRAWN, DRAWN[7:], "returned nothing (None); must be a Record; is a return missing?"),
    ("self.dt * np.arange(1", "-self.dt * np.arange(1", "time[0] is -0.02, after 0; time must ascend from 0"),
    (DRAWN, f"{WITH}time, record.truth", "returned a tuple of 2; must be a Record"),
    (DRAWN, f"{WITH}replace(record, truth=record.truth[:, 1:])",
     "truth is an array (2, 29, 3); must be an array (2, 30, 3)"),
    (DRAWN, f"{WITH}replace(record, truth=record.truth + np.nan)", "truth is NaN from time 0.02 on"),
    (DRAWN, f"{WITH}replace(record, truth=record.truth + np.inf)", "truth is infinite in places"),
    (DRAWN, f"{WITH}replace(record, time=time[::-1])", "time goes back from 0.6 at step 0 to 0.58; it must ascend"),
    (DRAWN, f"{WITH}replace(record, time=time * np.nan)", "time is nan at [0]; must be finite"),
    (DRAWN, f"{WITH}replace(record, time=list(time))", "time is a list of 30; must be an array (T,)"),
    (DRAWN, f"{WITH}replace(record, start=5.0)", "start is 5, after time[0] = 0.02"),
    (DRAWN, f"{WITH}replace(record, start=None)", "start is nothing (None); must be a finite time"),
    (DRAWN, f"{WITH}replace(record, readings=None)", "readings is nothing (None); must be a Readings"),
    (DRAWN, f"{WITH}replace(record, readings=replace(readings, step=readings.step[::-1]))",
     "readings.step goes back from 29 to 28"),
    (DRAWN, f"{WITH}replace(record, readings=replace(readings, step=readings.step + 1))",
     "readings.step has 30; steps are numbered 0 to 29"),
    (DRAWN, f"{WITH}replace(record, readings=replace(readings, step=readings.step * 1.0))",
     "readings.step is an array of float64; must hold integers"),
    (DRAWN, f"{WITH}replace(record, readings=replace(readings, values=readings.values[0]))",
     "readings.values is an array (30, 3); must be an array (m, 30, 3)"),
    (DRAWN, f"{WITH}replace(record, readings=replace(readings, values=readings.values + np.inf))",
     "readings.values is infinite in places"),
    (DRAWN, f"{WITH}replace(record, readings=replace(readings, values=readings.values.repeat(2, axis=0)))",
     "record: readings.values has 2 components; the sensor's space has 1"),
    (DRAWN, f"{WITH}replace(record, readings=replace(readings, landmark_number=readings.landmark_number + 1))",
     "record: readings.landmark_number is 1 for reading 0 of run 0; must be 0 to 0"),
    (DRAWN, f"{WITH}replace(record, readings=replace(readings, landmark_number=readings.landmark_number * 1.0))",
     "readings.landmark_number is an array of float64; must hold integers"),
    (DRAWN, f"{WITH}replace(record, prior=None)", "prior is nothing (None); must be a Gaussian or a Uniform"),
    (DRAWN, f"{WITH}replace(record, prior=prior)", "prior.mean is an array (2,); must be an array (2, 3)"),
    (DRAWN, f"{WITH}replace(record, prior=record.prior._replace(cov=-record.prior.cov))",
     "prior.cov is a matrix with the variance -0.01"),
    (DRAWN, f"{WITH}replace(record, origin=record.origin[0])", "origin is an array (3,); must be an array (2, 3)"),
    (DRAWN, f"{WITH}replace(record, landmarks=None)", "landmarks is nothing (None); must be an array (p,"),
    (DRAWN, f"{WITH}replace(record, remarks='windy')", "remarks is a str; must be a tuple of sentences"),
]  # fmt: skip


def _pendulum(source, **changes):
    """The README's pendulum, from its source as it was changed."""
    module = types.ModuleType("pendulum")
    exec(compile(source, "pendulum.py", "exec"), vars(module))
    module.Pendulum.__module__ = "pendulum"
    return module.Pendulum(**{"dt": 0.02, "duration": 0.6, "push_sd": 0.2, "reading_sd": 0.1} | changes)


@pytest.fixture(scope="module")
def plain():
    return settings("runs=3", "filter=ekf", names=Names("pendulum", "ekf"))


def _work(wanted):
    """What is done up to where filters begin."""
    with np.errstate(all="ignore"):
        loop_of(wanted, wanted.filter, np.empty((0, 1)))
        record = record_of(wanted, range(3))
        check_answers(wanted, record)


@pytest.mark.parametrize(
    ("where", "slips"),
    [("Pendulum.motion: ", MOTIONS), ("Pendulum.sensor: ", SENSORS), ("", SPACES), ("", RECORDS)],
    ids=["motions", "sensors", "spaces", "records"],
)
def test_each_slip_is_one_line_that_names_function_and_field(plain, where, slips):
    for right, wrong, said in slips:
        assert right in SOURCE
        scenario = _pendulum(SOURCE.replace(right, wrong, 1))
        with pytest.raises(AnswerError) as error:
            _work(replace(plain, scenario=scenario))
        line = str(error.value)
        assert re.match(rf"pendulum\.{re.escape(where)}" if where else r"pendulum\.Pendulum[.:]", line), (wrong, line)
        assert said in line, (wrong, line)
        assert "\n" not in line


def test_what_is_right_passes(plain):
    _work(replace(plain, scenario=_pendulum(SOURCE)))
    whole = f"{Q[:-1]}, lambda s, c, dt: ({RIGHT}, ((dt * dt,), (dt,))))"
    jacobian = f"{R}, landmarks, lambda s, p: ((np.cos(s[0]), 0.0),))"
    _work(replace(plain, scenario=_pendulum(SOURCE.replace(Q, whole).replace(f"{R}, landmarks)", jacobian))))


@pytest.mark.parametrize("scenario", [*options("scenario"), *plugged.NAMES])
@pytest.mark.parametrize("runs", [1, 3])
def test_every_problem_answers_as_it_must(scenario, runs):
    words = [f"runs={runs}", "filter=ekf"]
    wanted = (
        plugged.settings(scenario, *words) if scenario in plugged.NAMES else settings(f"scenario={scenario}", *words)
    )
    check_answers(wanted, record_of(wanted, range(runs)))


@dataclass(frozen=True)
class Own(GaussianFilter):
    """A filter of a user's own, whose answers may be spoilt."""

    spoil: str = ""

    def start(self, prior, generators):
        return None if self.spoil == "start" else super().start(prior, generators)

    def predict(self, motion, belief, control, dt):
        return None if self.spoil == "predict" else super().predict(motion, belief, control, dt)

    def update(self, sensor, belief, reading, landmark):
        belief, innovation = super().update(sensor, belief, reading, landmark)
        return {
            "update": belief,
            "fit": (belief, (innovation.whitened, innovation.gated)),
            "whitened": (belief, Innovation(innovation.whitened[0], innovation.log_scale, innovation.gated)),
        }.get(self.spoil, (belief, innovation))

    def moments(self, belief, motion):
        mean, cov = belief
        return {
            "moments": (mean, cov),
            "variances": Gaussian(mean, cov[range(len(cov)), range(len(cov))]),
            "indefinite": Gaussian(mean, -cov),
        }.get(self.spoil, belief)

    def sample(self, belief):
        return 1000 if self.spoil == "sample" else None

    def notes(self, belief):
        return {"particles": 1000} if self.spoil == "notes" else {}


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        ("start", "start returned nothing (None); must be a belief; is a return missing?"),
        ("predict", "predict returned nothing (None); must be a belief"),
        ("update", "update returned a Gaussian; must be a pair, of a belief and an Innovation"),
        ("fit", "update returned as its second a tuple of 2; must be an Innovation"),
        ("whitened", "update returned as whitened an array (2,); must be an array (1, 2)"),
        ("moments", "moments returned a tuple of 2; must be a Gaussian"),
        ("variances", "moments returned as cov an array (2, 3); must be an array (2, 2, 3)"),
        ("indefinite", "moments returned as cov a matrix with the variance -0.01"),
        ("sample", "sample returned the number 1000; must be a Sample"),
        ("notes", "notes returned for particles the number 1000; must be an array (3,)"),
    ],
)
def test_a_filter_of_a_users_own_is_asked_before_it_works(plain, spoil, said):
    own = Own(Linearised(), "additive", None)
    _work(replace(plain, scenario=_pendulum(SOURCE), filters={"ekf": own}))
    with pytest.raises(AnswerError) as error:
        _work(replace(plain, scenario=_pendulum(SOURCE), filters={"ekf": replace(own, spoil=spoil)}))
    assert str(error.value).startswith(f"tests.laws.test_border.Own: {said}")


def test_a_scheme_that_is_none_is_refused(plain):
    scenario = _pendulum(SOURCE + "\n    scheme = 'stacked'\n")
    with pytest.raises(AnswerError, match=r"^pendulum\.Pendulum\.scheme: is 'stacked'; must be one of sequential, "):
        _work(replace(plain, scenario=scenario))


def test_a_process_noise_is_looked_at_along_the_record(plain):
    """Not at its first step alone: here the command makes a variance negative later on."""
    source = SOURCE.replace(Q, "np.atleast_2d(0.01 - np.sum(control, axis=0) * 0.001)[None][0][:, :1], 1)")
    source = source.replace("np.empty((0, time.size, 1))", "np.arange(time.size * 1.0).reshape(1, -1, 1)")
    with pytest.raises(
        AnswerError, match=r"^pendulum\.Pendulum\.motion: noise_cov returned a matrix with the variance -"
    ):
        _work(replace(plain, scenario=_pendulum(source)))
