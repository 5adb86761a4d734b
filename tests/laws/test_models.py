"""Geometry against slower, independent ways to the same answer."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from estlab.compiled.exact import Exact
from estlab.maths.finite_differences import hessian, jacobian
from estlab.maths.space import Space, wrap
from estlab.maths.stacking import matrix
from estlab.maths.streams import Streams
from estlab.models import landmarks, lidar, unicycle, vehicle
from estlab.models.contract import Motion
from tests.conftest import options, settings

CAR = np.array([20.0, 4.0, 9.0, 2.8, 4.6, 1.9])
NOWHERE = np.empty((0, 1))


def _normals(*shape):
    return np.random.default_rng(11).standard_normal(shape)


def _check_jacobians(motion, state, control, dt):
    n, q = motion.space.size, motion.noise_size
    in_state, in_noise = (matrix(rows, state.shape[1:]) for rows in motion.jacobians(state, control, dt))
    by_difference = jacobian(lambda x: motion.step(x, control, np.zeros(q), dt), state, motion.space)
    np.testing.assert_allclose(in_state, by_difference, atol=1e-7 * max(1.0, np.abs(in_state).max()))
    silent = np.zeros((q, *state.shape[1:]))
    by_difference = jacobian(lambda w: motion.step(state[:, None], control, w, dt), silent, motion.space)
    np.testing.assert_allclose(in_noise, by_difference, atol=1e-7 * np.abs(in_noise).max(initial=1.0))
    assert in_state.shape[:2] == (n, n)
    assert in_noise.shape[:2] == (n, q)


@pytest.mark.parametrize("scenario", options("scenario"))
def test_stated_jacobians_are_the_finite_differences(scenario):
    experiment = settings(f"scenario={scenario}", "steps=5")
    problem, noise = experiment.scenario, experiment.noise.filter
    record = problem.simulate(Streams(3, scenario), range(4), noise).first(12)
    motion, sensor = problem.motion(noise), problem.sensor(noise, record.landmarks)
    step = min(6, record.time.size - 1)
    state, control = record.truth[:, step], record.control[:, step]
    if motion.jacobians is not None:
        _check_jacobians(motion, state, control, 0.13)
    if sensor.jacobian is not None:
        place = sensor.landmark(record.readings.landmark_number[0])
        stated = matrix(sensor.jacobian(state, place), state.shape[1:])
        np.testing.assert_allclose(stated, jacobian(lambda x: sensor.read(x, place), state, sensor.space), atol=1e-6)


def _assert_near(stated, found, batch):
    stated, found = matrix(stated, batch), matrix(found, batch)
    np.testing.assert_allclose(found, stated, rtol=0.0, atol=1e-11 * np.abs(stated).max(initial=1.0))


@pytest.mark.parametrize("scenario", options("scenario"))
def test_stated_derivatives_are_those_of_the_trace(scenario):
    experiment = settings(f"scenario={scenario}", "steps=5")
    problem, noise = experiment.scenario, experiment.noise.filter
    record = problem.simulate(Streams(3, scenario), range(4), noise).first(12)
    motion, sensor = problem.motion(noise), problem.sensor(noise, record.landmarks)
    step, n = min(6, record.time.size - 1), motion.space.size
    state, control, dt = record.truth[:, step], record.control[:, step], 0.13
    silent = np.zeros(motion.noise_size)
    traced = Exact(motion.move, (n, len(control), motion.noise_size, None), n)
    if motion.jacobians is not None:
        for stated, vector in zip(motion.jacobians(state, control, dt), (0, 2), strict=True):
            if len(stated[0]):
                _assert_near(stated, traced.jacobian((vector,), state, control, silent, dt), state.shape[1:])
    if motion.hessians is not None:
        found = traced.hessians((0,), state, control, silent, dt)
        for one, other in zip(motion.hessians(state, control, dt), found, strict=True):
            _assert_near(one, other, state.shape[1:])
    if sensor.jacobian is not None:
        traced, place = Exact(sensor.measure, (n, len(record.landmarks)), sensor.space.size), record.landmarks[:, 0]
        _assert_near(sensor.jacobian(state, place), traced.jacobian((0,), state, place), state.shape[1:])
        if sensor.hessians is not None:
            found = traced.hessians((0,), state, place)
            for one, other in zip(sensor.hessians(state, place), found, strict=True):
                _assert_near(one, other, state.shape[1:])


def test_a_model_that_states_no_derivatives_has_exact_ones_and_differences_if_it_cannot_be_traced():
    state, silent = CAR[:, None] + 0.1 * _normals(6, 3), np.zeros(6)
    bare = Motion(vehicle.SPACE, vehicle.drive, lambda control, dt: np.eye(6), 6)
    function, in_noise = bare.over(np.empty((0, 1)), 0.2)
    in_state, of_noise = vehicle.drive_jacobians(state, np.empty((0, 1)), 0.2)
    _assert_near(in_state, function.jacobian(state), (3,))
    _assert_near(of_noise, in_noise(state), (3,))
    joint = bare.joint_function(np.empty((0, 1)), 0.2).jacobian(np.concatenate([state, np.zeros((6, 3))]))
    _assert_near([(*a, *b) for a, b in zip(in_state, of_noise, strict=True)], joint, (3,))
    by_difference = hessian(lambda x: bare.step(x, np.empty((0, 1)), silent, 0.2), state, bare.unrolled)
    np.testing.assert_allclose(function.hessians(state), by_difference, atol=1e-5)
    hidden = Motion(vehicle.SPACE, lambda *given: tuple(map(np.asarray, vehicle.drive(*given))), bare.noise_cov, 6)
    assert hidden.function(np.empty((0, 1)), 0.2).stated_jacobian is not None
    masked = Motion(vehicle.SPACE, _masked_drive, bare.noise_cov, 6)
    without = masked.function(np.empty((0, 1)), 0.2)
    assert without.stated_jacobian is None
    np.testing.assert_allclose(without.jacobian(state), matrix(in_state, (3,)), atol=1e-7)


def test_a_distance_at_its_least_has_a_slope_of_nothing_and_what_is_not_taken_none():
    def function(x):
        a, b = x
        away = np.maximum(a, 0.0)
        return np.sqrt(away * away), np.hypot(a, b), np.where(a > 0.0, np.log(a), b)

    found = matrix(Exact(function, (2,), 3).jacobian((0,), np.zeros((2, 1))), (1,))
    np.testing.assert_array_equal(found[..., 0], [[0.0, 0.0], [0.0, 0.0], [0.0, 1.0]])


def _masked_drive(state, control, noise, dt):
    after = np.array(np.broadcast_arrays(*vehicle.drive(state, control, noise, dt)), dtype=float)
    after[after > 1e300] = np.inf
    return tuple(after)


@pytest.mark.parametrize("w", [0.0, 1e-9, 1e-4, -0.3, 2.0])
def test_arc_is_the_integral_of_the_unicycle(w):
    def rates(_, pose):
        return [0.7 * np.cos(pose[2]), 0.7 * np.sin(pose[2]), w]

    exact = solve_ivp(rates, (0.0, 1.5), [1.0, -2.0, 0.4], rtol=1e-11, atol=1e-12).y[:, -1]
    found = unicycle.arc(np.array([1.0, -2.0, 0.4]), np.array([0.7, w]), np.zeros(2), 1.5)
    np.testing.assert_allclose(found, exact, atol=1e-9)
    jacobians = unicycle.arc_jacobians(np.array([1.0, -2.0, 0.4]), np.array([0.7, w]), 1.5)
    by_difference = jacobian(
        lambda u: np.stack(np.broadcast_arrays(*unicycle.arc(np.array([1.0, -2.0, 0.4]), np.array([0.7, w]), u, 1.5))),
        np.zeros(2),
        unicycle.SPACE,
    )
    np.testing.assert_allclose(matrix(jacobians[1], ()), by_difference, atol=1e-8)


def _arc_by_quadrature(pose, control, dt):
    """The pose after an arc, and its derivatives (3, 3) in the pose and (3, 2) in v and w, as integrals over time."""
    nodes, weights = np.polynomial.legendre.leggauss(30)
    t, share = 0.5 * dt * (nodes + 1.0), 0.5 * dt * weights
    (x, y, heading), (v, w) = pose, control
    cos, sin = np.cos(heading + w * t), np.sin(heading + w * t)
    after = np.array([x + v * (share @ cos), y + v * (share @ sin), heading + w * dt])
    in_pose = np.eye(3)
    in_pose[:2, 2] = -v * (share @ sin), v * (share @ cos)
    in_noise = [[share @ cos, -v * (share @ (t * sin))], [share @ sin, v * (share @ (t * cos))], [0.0, dt]]
    return after, in_pose, np.array(in_noise)


# Of the angle through which half an arc turns [rad]: none, next to none, about the branch between series and quotient.
HALF_TURNS = [0.0, 1e-200, -1e-18, 1e-9, -1e-5, 1e-3, -9e-3, 0.00999999, 0.01, 0.01000001, -0.0101, 0.03, 0.09, -1.5]


@pytest.mark.parametrize("half_turn", HALF_TURNS)
@pytest.mark.parametrize("heading", [0.4, -2.9, 30.0])
def test_an_arc_and_its_jacobians_are_integrals_however_little_it_turns(half_turn, heading):
    pose, control, dt = np.array([1.0, -2.0, heading]), np.array([0.7, 2.0 * half_turn / 1.5]), 1.5
    after, in_pose, in_noise = _arc_by_quadrature(pose, control, dt)
    np.testing.assert_allclose(unicycle.arc(pose, control, np.zeros(2), dt), after, rtol=1e-14, atol=1e-14)
    jacobians = (matrix(rows, ()) for rows in unicycle.arc_jacobians(pose, control, dt))
    for found, expected in zip(jacobians, (in_pose, in_noise), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-14)


@pytest.mark.parametrize("half_turn", [half for half in HALF_TURNS if half != 0.0])
def test_how_much_shorter_the_chord_gets_by_turning_more_has_all_digits(half_turn):
    """With the chord along x the slope of x in w is this alone; elsewhere the turn of the chord hides it."""
    pose, control = np.array([0.0, 0.0, -half_turn]), np.array([0.7, 2.0 * half_turn / 1.5])
    found = matrix(unicycle.arc_jacobians(pose, control, 1.5)[1], ())[0, 1]
    # The derivative of sin(a) / a by its series, in which nothing cancels.
    terms = [(-1) ** k * 2 * k * half_turn ** (2 * k - 1) / math.factorial(2 * k + 1) for k in range(1, 13)]
    np.testing.assert_allclose(found, 0.7 * 1.5 * 0.75 * math.fsum(terms), rtol=1e-11, atol=0.0)


def test_arcs_are_the_same_for_numbers_and_for_arrays():
    pose, control, noise = np.split(_normals(7, 40), [3, 5])
    control[1, :20] *= 10.0 ** -np.arange(20)
    noise[1, :20] = 0.0
    together = np.stack(unicycle.arc(pose, control, noise, 0.1))
    jacobians = [matrix(rows, (40,)) for rows in unicycle.arc_jacobians(pose, control, 0.1)]
    for i in range(40):
        alone = unicycle.arc(pose[:, i], control[:, i], noise[:, i], 0.1)
        np.testing.assert_array_equal(np.array(alone), together[:, i])
        for rows, among in zip(unicycle.arc_jacobians(pose[:, i], control[:, i], 0.1), jacobians, strict=True):
            np.testing.assert_array_equal(matrix(rows, ()), among[..., i])


def test_drive_is_a_runge_kutta_step_of_the_documents_derivative():
    rates = np.array([0.2, -0.1, 4.0, 0.9, 0.3, -0.2])

    def slope(_, s):
        return [s[2] * np.cos(s[3]) + rates[0], s[2] * np.sin(s[3]) + rates[1], *rates[2:]]

    exact = solve_ivp(slope, (0.0, 0.1), CAR, rtol=1e-11, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(vehicle.drive(CAR, np.empty(0), rates, 0.1), exact, atol=2e-7)


def _driven(state, rates, dt):
    """The document's form: Simpson's rule over speed and heading at the beginning, in the middle and at the end."""
    begin, middle, end = (state + share * dt * rates for share in (0.0, 0.5, 1.0))
    for i, of in ((0, np.cos), (1, np.sin)):
        velocities = [at[2] * of(at[3]) for at in (begin, middle, end)]
        end[i] += dt / 6.0 * (velocities[0] + 4.0 * velocities[1] + velocities[2])
    return end


def _cars(count, seed=7):
    """Cars all round, near and far, among them some of negative size and some with the origin inside."""
    rng = np.random.default_rng(seed)
    around, heading = rng.uniform(-np.pi, np.pi, (2, count))
    far = 10.0 ** rng.uniform(-1.0, 2.0, count)
    speed, length, width = rng.uniform(-15.0, 15.0, count), rng.uniform(-3.0, 8.0, count), rng.uniform(-1.0, 4.0, count)
    return np.stack([far * np.cos(around), far * np.sin(around), speed, heading, length, width])


@pytest.mark.parametrize("turn_rate", [0.0, 0.7, 30.0])  # [rad/s] per sqrt(s); at 30, more than a turn in a step
def test_drive_is_simpsons_rule_of_the_documents_form(turn_rate):
    cars = _cars(600).reshape(6, 3, 200)
    rates = _normals(6, 3, 200) * np.array([0.25, 0.25, 3.0, turn_rate, 0.1, 0.1])[:, None, None]
    found = np.stack(vehicle.drive(cars, np.empty(0), rates, 0.1))
    np.testing.assert_allclose(found, _driven(cars, rates, 0.1), rtol=1e-14, atol=1e-14)


def test_cars_drive_and_are_seen_the_same_as_numbers_and_as_arrays():
    cars, rates = _cars(60), _normals(6, 60)
    driven, seen = np.stack(vehicle.drive(cars, np.empty(0), rates, 0.1)), np.stack(vehicle.extent(cars, NOWHERE))
    for i in range(60):
        np.testing.assert_array_equal(np.array(vehicle.drive(cars[:, i], np.empty(0), rates[:, i], 0.1)), driven[:, i])
        np.testing.assert_array_equal(np.array(vehicle.extent(cars[:, i], NOWHERE)), seen[:, i])


def _extent_by_corners(state):
    """Bearings by the arctangent of each corner, the range by the nearest point of each edge."""
    x, y, _, heading, length, width = state
    ahead, left = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
    rear, side = np.array([x, y]), 0.5 * width * left
    corners = [rear - side, rear + length * ahead - side, rear + length * ahead + side, rear + side]
    centre = rear + 0.5 * length * ahead
    reference = np.arctan2(centre[1], centre[0])
    turned = [wrap(np.arctan2(corner[1], corner[0]) - reference) for corner in corners]
    ranges = []
    for one, other in zip(corners, corners[1:] + corners[:1], strict=True):
        along = other - one
        nearest = one + np.clip(-(one @ along) / (along @ along), 0.0, 1.0) * along
        ranges.append(np.hypot(*nearest))
    return reference + min(turned), reference + max(turned), min(ranges)


def _holds_the_origin(cars):
    x, y, _, heading, length, width = cars
    along, across = -(x * np.cos(heading) + y * np.sin(heading)), x * np.sin(heading) - y * np.cos(heading)
    return (np.abs(along - 0.5 * length) < 0.5 * np.abs(length)) & (np.abs(across) < 0.5 * np.abs(width))


def test_extent_is_that_of_the_corners_and_the_nearest_point_of_the_edges():
    cars = _cars(1500)
    cars[:2, :300] = -np.abs(cars[:2, :300]) * np.array([[1.0], [0.01]])  # across the cut, behind the origin
    inside, negative = _holds_the_origin(cars), (cars[4:] < 0.0).any(axis=0)
    cut = np.abs(vehicle.extent(cars, NOWHERE)[1]) > np.pi
    assert min(inside.sum(), negative.sum(), cut.sum(), (inside & negative).sum()) > 20, "some of each kind"
    expected = np.stack([_extent_by_corners(car) for car in cars.T], axis=1)
    gap = np.stack(vehicle.extent(cars, NOWHERE)) - expected
    np.testing.assert_allclose(wrap(gap[:2]), 0.0, atol=1e-12)
    np.testing.assert_allclose(gap[2], 0.0, atol=1e-13 * np.abs(cars[:2]).max())


def _outline(state, per_edge=4001):
    corner = vehicle.corners(state[:, None])[:, :, 0]
    share = np.linspace(0.0, 1.0, per_edge)
    return np.concatenate(
        [corner[:, [i]] + (corner[:, [(i + 1) % 4]] - corner[:, [i]]) * share for i in range(4)], axis=1
    )


@given(
    st.floats(0.0, 2 * np.pi),
    st.floats(0.0, 2 * np.pi),
    st.floats(8.0, 60.0),
    st.floats(-5.0, 6.0),
    st.floats(-2.0, 3.0),
)
def test_extent_is_that_of_the_outline_walked_in_small_steps(around, heading, far, length, width):
    state = np.array([far * np.cos(around), far * np.sin(around), 5.0, heading, length, width])
    outline = _outline(state)
    middle = outline.mean(axis=1)
    turned = wrap(np.arctan2(outline[1], outline[0]) - np.arctan2(middle[1], middle[0]))
    least, most, nearest = vehicle.extent(state, NOWHERE)
    reference = np.arctan2(middle[1], middle[0])
    np.testing.assert_allclose(
        wrap(np.array([least - reference - turned.min(), most - reference - turned.max()])), 0.0, atol=1e-9
    )
    np.testing.assert_allclose(nearest, np.hypot(*outline).min(), atol=2e-3)


def test_smallest_range_from_inside_is_to_the_nearest_edge():
    inside = np.array([-1.0, 0.2, 5.0, 0.0, 4.0, 2.0])  # rear edge 1 m behind the origin, side edges at -0.8 and 1.2
    assert vehicle.extent(inside, NOWHERE)[2] == pytest.approx(0.8)


def test_a_car_across_the_cut_is_narrow():
    behind = np.array([-20.0, -2.0, 5.0, np.pi / 2, 4.0, 2.0])
    least, most, _ = vehicle.extent(behind, NOWHERE)
    assert 0.0 < wrap(most) - wrap(least) + 2 * np.pi < 0.25


def test_every_lidar_point_lies_on_a_visible_edge_at_a_whole_half_degree():
    states = np.stack([CAR, CAR + [30, 2, 0, 1.0, 0, 0], CAR * [-1, 1, 1, -1, 1, 1]], axis=1)
    points, owner = lidar.cast(states)
    assert np.bincount(owner).min() >= 3
    steps = points[1] / np.radians(0.5)
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-9)
    for i in range(3):
        distance, bearing = points[:, owner == i]
        outline = _outline(states[:, i], 20001)
        place = np.stack([distance * np.cos(bearing), distance * np.sin(bearing)])
        to_outline = np.hypot(*(place[:, :, None] - outline[:, None])).min(axis=1)
        assert to_outline.max() < 1e-3
        at = np.abs(wrap(np.arctan2(outline[1], outline[0])[None] - bearing[:, None])) < 1e-3
        nearest = np.where(at, np.hypot(*outline)[None], np.inf).min(axis=1)
        assert (distance <= nearest + 0.1).all(), "a point behind a nearer edge"


def test_the_measurement_from_a_noiseless_frame_is_the_extent_to_half_a_degree():
    states = np.stack([CAR, CAR * [-1, 0, 1, 1, 1, 1]], axis=1)  # the second lies across the cut
    measured = lidar.measure_frames(*lidar.cast(states), 2)
    exact = np.stack(vehicle.extent(states, NOWHERE))
    off = vehicle.READING.minus(measured, exact)
    assert (off[0] >= 0).all()
    assert (off[0] <= np.radians(0.5)).all()
    assert (off[1] <= 0).all()
    assert (off[1] >= -np.radians(0.5)).all()
    assert (off[2] >= -1e-9).all()


def test_a_frame_without_a_point_is_not_measured():
    points, owner = lidar.cast(np.array([[1e5], [300.0], [1.0], [0.0], [4.0], [2.0]]))
    assert owner.size == 0
    assert np.isnan(lidar.measure_frames(points, owner, 1)).all()


def test_a_reading_puts_its_landmark_where_it_is():
    pose, mark = np.array([1.0, -2.0, 2.5]), np.array([4.0, 3.0])
    np.testing.assert_allclose(landmarks.seen_at(pose, np.stack(landmarks.range_bearing(pose, mark))), mark, atol=1e-12)


def test_second_differences_are_the_second_derivatives():
    def bent(x):
        return np.stack([x[0] ** 2 * x[1] + np.sin(x[2]), np.exp(0.3 * x[0]) * x[1] * x[2]])

    at = np.array([[1.2, -3.0], [0.7, 40.0], [-0.4, 2.0]])
    x, y, z = at
    e = np.exp(0.3 * x)
    zero = np.zeros(2)
    exact = np.array(
        [
            [[2 * y, 2 * x, zero], [2 * x, zero, zero], [zero, zero, -np.sin(z)]],
            [[0.09 * e * y * z, 0.3 * e * z, 0.3 * e * y], [0.3 * e * z, zero, e], [0.3 * e * y, e, zero]],
        ]
    )
    found = hessian(bent, at, Space(("a", "b"), ("", "")))
    np.testing.assert_allclose(found, exact, atol=2e-4 * np.abs(exact).max())


def test_differences_respect_the_cut():
    heading = Space(("bearing",), ("rad",), angles=(0,))
    slope = jacobian(lambda x: np.arctan2(x[1], x[0])[None], np.array([-1.0, 1e-9]), heading)
    np.testing.assert_allclose(slope, [[0.0, -1.0]], atol=1e-6)
