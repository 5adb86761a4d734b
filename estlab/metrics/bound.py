"""The posterior Cramer-Rao bound: a lower limit for the error of any estimator."""

import numpy as np

from estlab.maths.linalg import cholesky, matmul, solve_lower, without
from estlab.maths.space import Array, Space
from estlab.models.contract import Motion, Sensor
from estlab.record import Record

_NEGLIGIBLE = 1e-9  # of the largest singular value: directions below it are rounding errors


def posterior_bound(record: Record, motion: Motion, sensor: Sensor) -> Array:
    """C[k] <= E[e e'] for the error e of any estimator of x[k] from the readings up to step k: (n, n, T).

    Let theta = (x[0], w[1], ..., w[k]) in units of their standard deviations, s = d log p(z, theta) / d theta its
    score and S = dx[k] / d theta. Take directions V(theta) in which each noise is weighted only by functions of what
    came before it. They have no divergence, so integration by parts gives E[e (V's)'] = E[S V], and independent
    noises give J = E[V'ss'V] as below. The covariance inequality for e and V's is then

        E[e e'] >= E[S V] J^-1 E[S V]',    J = E[V'V] + the sum over the readings of E[(H S V)' R^-1 (H S V)].

    V = 1 is the total information of start and noises; it also works for a singular process noise. But when headings
    spread over the runs, E[S] averages opposite directions to nothing, and the bound becomes loose. So V has each
    noise times 1 and times the cosine and sine of every angle of the state before it. Fewer directions give a bound
    too. After each step only the combinations are kept that are best for x[k] times these functions, which makes the
    cost linear in T. On a linear model this is a square-root Kalman filter.

    motion, sensor: with the truth's noises. Derivatives are taken at the true state and at no noise. Expectations are
    means over the runs: with few runs the bound comes out too high, by the order of 1 / runs of it; with one run it
    is the extended Kalman filter's covariance about the truth. A start that equals the prior's mean in every run is
    no parameter. Where the mean is drawn about the truth, it counts as one more reading of x[0], and the bound is a
    hybrid one, for estimators without bias at that start. Commands, and the set of visible landmarks, are taken as
    given: information that they carry about the truth is not counted. A NaN in a reading counts as missing.

    Van Trees 1968, section 2.4.3; Bobrovsky, Mayer-Wolf and Zakai 1987 (weights); Rockah and Schultheiss 1987
    (hybrid); Tichavsky, Muravchik and Nehorai 1998 (filtering). Raises ValueError for a record without origin.
    """
    if record.origin is None:
        raise ValueError("the record has no origin, so there is no bound")
    n, steps = motion.space.size, record.time.size
    lapse = np.diff(record.time, prepend=record.start)
    bounds = record.readings.bounds(steps)
    bound = np.empty((n, n, steps))
    state = record.origin
    functions = _functions(motion.space, state)
    # Jacobians dx/dv (p, n, runs) along directions chosen so that their information is the identity.
    jacobians = _of_start(record, state)
    for k in range(steps):
        if lapse[k] > 0.0:
            jacobians = _moved(jacobians, functions, motion, state, record.control[:, k], float(lapse[k]))
        state = record.truth[:, k]
        seen = [_of_reading(jacobians, record, sensor, state, i) for i in range(bounds[k], bounds[k + 1])]
        jacobians = _informed(jacobians, seen)
        mean = jacobians.mean(axis=2)
        bound[:, :, k] = mean.T @ mean
        functions = _functions(motion.space, state)
        jacobians = _condensed(jacobians, functions)
    return bound


def _of_start(record: Record, origin: Array) -> Array:
    prior = record.prior.fitted()
    if (origin == prior.mean).all():
        return np.empty((0, *origin.shape))
    return np.repeat(_root(prior.cov).T[..., None], origin.shape[1], axis=2)


def _functions(space: Space, state: Array) -> Array:
    """1 and each angle's cosine and sine, orthonormal over the runs: (a, runs), fewer if they are dependent."""
    angles = state[list(space.angles)]
    raw = np.concatenate([np.ones((1, state.shape[1])), np.cos(angles), np.sin(angles)])
    return np.sqrt(state.shape[1]) * _basis(raw)


def _moved(jacobians: Array, functions: Array, motion: Motion, state: Array, control: Array, lapse: float) -> Array:
    """The directions after a step, which adds those of its noise."""
    in_state = motion.function(control, lapse).jacobian(state)
    in_noise = matmul(motion.noise_jacobian(state, control, lapse), _root(motion.noise_cov(control, lapse)))
    fresh = np.einsum("ar,iqr->aqir", functions, in_noise).reshape(len(functions) * motion.noise_size, *state.shape)
    return np.concatenate([np.einsum("ijr,pjr->pir", in_state, jacobians), fresh])


def _of_reading(jacobians: Array, record: Record, sensor: Sensor, state: Array, i: int) -> Array:
    """L^-1 H dx/dv of reading i, with R = L L': (p, m * runs), zero for what is missing."""
    missing = np.isnan(record.readings.values[:, i])
    landmark = sensor.landmark(record.readings.landmark_number[i])
    jacobian = np.where(missing[:, None], 0.0, sensor.function(landmark).jacobian(state))
    whitened = solve_lower(cholesky(without(sensor.noise_cov, missing)), jacobian)
    return np.einsum("mir,pir->pmr", whitened, jacobians).reshape(jacobians.shape[0], record.runs * len(whitened))


def _informed(jacobians: Array, seen: list[Array]) -> Array:
    """The directions rescaled so that their information is the identity again."""
    size, n, runs = jacobians.shape
    # The information is R'R, and is never formed: squares of readings 1e8 times as good as the start would hide the
    # 1.
    stacked = np.concatenate([np.eye(size), *(part.T / np.sqrt(runs) for part in seen if part.any())])
    scaled = np.linalg.solve(np.asarray(np.linalg.qr(stacked, mode="r")).T, jacobians.reshape(size, n * runs))
    return np.asarray(scaled.reshape(jacobians.shape))


def _condensed(jacobians: Array, functions: Array) -> Array:
    """As many directions as are needed to bound the state times each of the functions (a, runs): a n or fewer."""
    size, n, runs = jacobians.shape
    aims = (jacobians.reshape(size * n, runs) @ functions.T).reshape(size, n * len(functions)).T
    length = np.linalg.norm(aims, axis=1, keepdims=True)
    basis = _basis(aims / np.where(length > 0.0, length, 1.0))
    return np.asarray((basis @ jacobians.reshape(size, n * runs)).reshape(len(basis), n, runs))


def _basis(rows: Array) -> Array:
    """Orthonormal rows that span the same space."""
    _, sizes, basis = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(basis[sizes > _NEGLIGIBLE * sizes[:1]])


def _root(cov: Array) -> Array:
    """A with A A' = P (q, q, *batch), also for singular P."""
    values, vectors = np.linalg.eigh(np.moveaxis(cov, (0, 1), (-2, -1)))
    return np.moveaxis(vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :], (-2, -1), (0, 1))
