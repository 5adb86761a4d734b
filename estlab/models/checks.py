"""Checks a motion and a sensor against their contract at a belief: alone, in runs and in points."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.linalg import cholesky
from estlab.maths.space import TURN, Array, Space
from estlab.models.answers import components, covariance, instance, named, quietly, refuse, rows, unchanged
from estlab.models.contract import Motion, Sensor

_STEPS = 50  # steps whose process noise is checked: some of all
_POINTS = 3  # points at which derivatives are compared with differences: near a kink one may disagree


def check_space(where: str, space: Any, least: int) -> None:
    """Raise AnswerError unless this is a space with consistent parts."""
    instance(where, "is", space, Space)
    for field in ("names", "units"):
        value = getattr(space, field)
        if not isinstance(value, tuple) or not all(isinstance(part, str) for part in value):
            refuse(where, f"{field} = {value!r}; must be a tuple of words, one for each component")
    if len(space.names) != len(space.units):
        refuse(where, f"{len(space.names)} names and {len(space.units)} units; each component needs one of each")
    if len(space.names) < least:
        refuse(where, f"no component; it must have {least} or more")
    if len(set(space.names)) != len(space.names):
        refuse(where, f"names = {space.names}; each component needs its own name")
    for field in ("angles", "position"):
        value = getattr(space, field)
        if not isinstance(value, tuple) or not all(isinstance(i, int) and 0 <= i < space.size for i in value):
            refuse(where, f"{field} = {value!r}; must be a tuple of indices of components, from 0 to {space.size - 1}")
        if len(set(value)) != len(value):
            refuse(where, f"{field} = {value!r}; it names a component twice")


def check_motion(where: str, motion: Any, state: Space) -> Motion:
    """Check everything about the motion that needs no state."""
    instance(where, "returned", motion, Motion)
    _same_space(where, "space", motion.space, state)
    for field in ("move", "noise_cov", "jacobians", "hessians"):
        _callable(where, field, getattr(motion, field), optional=field in ("jacobians", "hessians"))
    if not isinstance(motion.noise_size, int | np.integer) or motion.noise_size < 0:
        refuse(where, f"noise_size = {motion.noise_size!r}; must be an integer, the number of components of the noise")
    return motion


def check_sensor(where: str, sensor: Any, state: Space) -> Sensor:
    """Check everything about the sensor that needs no state."""
    instance(where, "returned", sensor, Sensor)
    check_space(f"{where}: space", sensor.space, 0)
    _same_space(where, "state", sensor.state, state)
    for field in ("measure", "jacobian", "hessians"):
        _callable(where, field, getattr(sensor, field), optional=field != "measure")
    m = sensor.space.size
    covariance(where, "noise_cov is", sensor.noise_cov, (m, m))
    if not isinstance(sensor.landmarks, np.ndarray) or sensor.landmarks.ndim != 2:
        refuse(
            where, "landmarks must be an array (p, number of them), such as np.empty((0, 1)) if there are no landmarks"
        )
    return sensor


def check_noise(where: str, sensor: Sensor) -> None:
    """Raise AnswerError if a filter cannot use the sensor's noise: a reading without noise leaves no covariance."""
    pivots = np.diag(cholesky(sensor.noise_cov))
    if not (pivots > 0.0).all():
        free = sensor.space.names[int(np.argmin(pivots > 0.0))]
        refuse(
            where,
            f"noise_cov is singular: {free} has no noise of its own, but filters need some; give it the "
            "variance of its last digit",
        )


@quietly
def try_motion(where: str, motion: Motion, begin: Gaussian, control: Array, lapse: Array) -> None:
    """Raise AnswerError unless the motion works from a belief on.

    begin: mean (n, runs), cov (n, n). control: (c, T, runs or 1). lapse: (T,) duration of each step [s].
    """
    moving = np.flatnonzero(lapse > 0.0)
    if moving.size == 0:
        return
    at = _Start(motion.space, begin)
    for k in moving[:: max(1, moving.size // _STEPS)]:
        _try_noise(where, motion, control[:, k], float(lapse[k]))
    k = int(moving[0])
    control, dt, q = control[:, k], float(lapse[k]), motion.noise_size
    role, names = named(motion.move, "move"), motion.space.names

    def move(state: Array, command: Array, noise: Array) -> Array:
        value = unchanged(where, role, motion.move, state, command, noise, dt)
        return components(where, f"{role} returned", value, names, state.shape[1:])

    after = move(at.mean[:, 0], control[:, 0], np.zeros(q))
    _finite(where, f"{role} returned", after, names, at)
    alone = np.stack([move(point, control[:, 0], np.full(q, 1e-3)) for point in at.points[..., 0].T], axis=1)
    noise = np.full((q, *at.points.shape[1:]), 1e-3)
    _alike(where, role, move(at.points, control[:, : at.runs], noise)[..., 0], alone, names)
    quiet = move(at.mean, control[:, : at.runs], np.zeros(q))
    _alike(where, role, quiet[:, :1], after[:, None], names)
    _unrolled(where, role, motion, at, control[:, 0], dt)
    if motion.jacobians is not None:
        _try_jacobians(where, motion, at, control, dt)
    if motion.hessians is not None:
        state, command = at.mean[:, 0], control[:, 0]
        value = unchanged(where, "hessians", motion.hessians, state, command, dt)
        _try_hessians(where, named(motion.hessians, "hessians"), value, names, at)


@quietly
def try_sensor(where: str, sensor: Sensor, begin: Gaussian, landmark: Array) -> None:
    """Raise AnswerError unless the sensor works at a belief.

    begin: mean (n, runs), cov (n, n). landmark: (p, runs), what the readings are about.
    """
    at = _Start(sensor.state, begin)
    landmark = landmark[:, : at.runs]
    role, names = named(sensor.measure, "measure"), sensor.space.names

    def read(state: Array, about: Array) -> Array:
        value = unchanged(where, role, sensor.measure, state, about)
        return components(where, f"{role} returned", value, names, state.shape[1:])

    first = read(at.mean[:, 0], landmark[:, 0])
    alone = np.stack([read(point, landmark[:, 0]) for point in at.points[..., 0].T], axis=1)
    if not np.isfinite(np.column_stack([first, alone])).all(axis=0).any():
        _finite(where, f"{role} returned", first, names, at)
    _alike(where, role, read(at.points, landmark)[..., 0], alone, names)
    _alike(where, role, read(at.mean, landmark)[:, :1], first[:, None], names)
    if sensor.jacobian is not None:
        role, jacobian = named(sensor.jacobian, "jacobian"), sensor.jacobian
        m, n = sensor.space.size, sensor.state.size
        for state, about in ((at.mean[:, 0], landmark[:, 0]), (at.mean, landmark)):
            rows(where, f"{role} returned", unchanged(where, role, jacobian, state, about), m, n, state.shape[1:])
        function = sensor.function(landmark[:, 0])
        differenced = replace(function, stated_jacobian=None)
        pairs = [(function.jacobian(x), differenced.jacobian(x), function.evaluate(x)) for x in at.near]
        _agree(where, role, pairs, at, names, sensor.state.names)
    if sensor.hessians is not None:
        value = unchanged(where, "hessians", sensor.hessians, at.mean[:, 0], landmark[:, 0])
        _try_hessians(where, named(sensor.hessians, "hessians"), value, names, at)


class _Start:
    """The mean (n, runs) of a belief in a run or two; points (n, p, runs) about it; near (p, n), those of the first."""

    def __init__(self, space: Space, belief: Gaussian) -> None:
        mean, cov = belief
        self.space, self.runs = space, min(2, mean.shape[1])
        self.mean = mean[:, : self.runs].copy()
        variances = cov[range(space.size), range(space.size)].reshape(space.size, -1)[:, :1]
        spread = np.where(variances > 0.0, 0.1 * np.sqrt(variances), 1e-3 * np.maximum(1.0, np.abs(self.mean[:, :1])))
        # Components vary independently, so that no symmetry of a model hides a mistake.
        steps = np.sin(1.0 + 2.3 * np.arange(space.size)[:, None] + 1.7 * np.arange(1, _POINTS)) * spread
        self.points = np.concatenate([self.mean[:, None], self.mean[:, None] + steps[..., None]], axis=1)
        self.near = self.points[..., 0].T

    def __str__(self) -> str:
        entries = [f"{name}={value:.6g}" for name, value in zip(self.space.names, self.mean[:, 0], strict=True)][:8]
        return ", ".join([*entries, "..."] if self.space.size > 8 else entries)


def _try_noise(where: str, motion: Motion, control: Array, dt: float) -> None:
    q, role = motion.noise_size, named(motion.noise_cov, "noise_cov")
    for command, shapes in (
        (control[:, 0], [(q, q)]),
        (control, [(q, q), (q, q, control.shape[1]), (q, q, 1)]),
    ):
        value = unchanged(where, role, motion.noise_cov, command, dt)
        covariance(where, f"{role} returned", value, *shapes)


def _try_jacobians(where: str, motion: Motion, at: _Start, control: Array, dt: float) -> None:
    assert motion.jacobians is not None
    role, n, q = named(motion.jacobians, "jacobians"), motion.space.size, motion.noise_size
    for state, command in ((at.mean[:, 0], control[:, 0]), (at.mean, control[:, : at.runs])):
        pair = unchanged(where, role, motion.jacobians, state, command, dt)
        if not isinstance(pair, tuple | list) or len(pair) != 2:
            refuse(where, f"{role} must return two matrices as rows: of dx/dx ({n} by {n}) and of dx/dw ({n} by {q})")
        rows(where, f"{role} returned for dx/dx", pair[0], n, n, state.shape[1:])
        rows(where, f"{role} returned for dx/dw", pair[1], n, q, state.shape[1:])
    by_differences, command = replace(motion, jacobians=None), control[:, 0]
    names, noises = motion.space.names, [f"noise {i}" for i in range(q)]
    stated, found = motion.function(command, dt), by_differences.function(command, dt)
    pairs = [(stated.jacobian(x), found.jacobian(x), found.evaluate(x)) for x in at.near]
    _agree(where, role, pairs, at, names, names)
    pairs = [
        (motion.noise_jacobian(x, command, dt), by_differences.noise_jacobian(x, command, dt), found.evaluate(x))
        for x in at.near
    ]
    _agree(where, role, pairs, at, names, noises)


def _agree(
    where: str, role: str, pairs: list[tuple[Array, Array, Array]], at: _Start, of: tuple[str, ...], to: Any
) -> None:
    """Stated derivatives and differences must agree near one of the points; they do unless each has a kink."""
    wrong = []
    for stated, found, value in pairs:
        slack = 1e-3 * np.maximum(np.abs(stated), np.abs(found)) + 1e-6 * np.maximum(1.0, np.abs(value))[:, None]
        wrong.append(~(np.abs(stated - found) <= slack) & np.isfinite(found))
    everywhere = np.all(wrong, axis=0)
    if everywhere.any():
        i, j = (int(k) for k in np.argwhere(everywhere)[0])
        stated, found = pairs[0][0][i, j], pairs[0][1][i, j]
        refuse(
            where,
            f"{role}: the derivative of {of[i]} in {to[j]} is stated as {stated:.6g} and is {found:.6g} by "
            f"differences, at {at}; correct it, or leave {role.partition(' ')[0]} out",
        )


def _try_hessians(where: str, role: str, value: Any, names: tuple[str, ...], at: _Start) -> None:
    n = at.space.size
    if not isinstance(value, tuple | list | np.ndarray) or len(value) != len(names):
        refuse(where, f"{role} must return a matrix ({n} by {n}) for each of {len(names)} components")
    for name, matrix in zip(names, value, strict=True):
        rows(where, f"{role} returned for {name}", matrix, n, n, ())


def _unrolled(where: str, role: str, motion: Motion, at: _Start, control: Array, dt: float) -> None:
    """An angle that changes smoothly with itself must also change by a whole turn with itself."""
    silent = np.zeros(motion.noise_size)
    for i in motion.space.angles:
        some, turned = at.near[-1].copy(), at.near[-1].copy()
        some[i] += 1e-3
        turned[i] += TURN
        here, little, turn = (motion.step(x, control, silent, dt)[i] for x in (at.near[-1], some, turned))
        if abs(little - here - 1e-3) < 1e-5 and abs(turn - here) < 1e-6:
            refuse(where, f"{role} wraps {motion.space.names[i]}; return it unrolled, the space wraps it")


def _alike(where: str, role: str, among: Array, alone: Array, names: tuple[str, ...]) -> None:
    """Points among others must give the same as alone."""
    off = ~np.isclose(among, alone, rtol=1e-9, atol=1e-12, equal_nan=True)
    if off.any():
        i, p = np.argwhere(off)[0]
        refuse(
            where,
            f"{role} gives {names[i]} = {among[i, p]:.6g} for a point among others and {alone[i, p]:.6g} for "
            "it alone; compute each point separately",
        )


def _finite(where: str, what: str, values: Array, names: tuple[str, ...], at: _Start) -> None:
    if not np.isfinite(values).all():
        i = int(np.argmin(np.isfinite(values)))
        refuse(where, f"{what} {values[i]:g} for {names[i]} at the start, {at}; must be finite")


def _same_space(where: str, field: str, found: Any, state: Space) -> None:
    instance(where, f"{field} is", found, Space)
    if found != state:
        refuse(where, f"{field} is that of {found.names}; must be the scenario's, of {state.names}, angles and all")


def _callable(where: str, field: str, value: Callable[..., Any] | None, optional: bool) -> None:
    if not (callable(value) or (optional and value is None)):
        refuse(where, f"{field} = {value!r}; must be a function{', or None' if optional else ''}")
