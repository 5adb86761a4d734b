"""The noises of all steps of a record, evaluated before compiled code runs over them."""

from typing import NamedTuple

import numpy as np

from estlab.maths.linalg import cholesky
from estlab.maths.space import Array
from estlab.models.contract import Motion


class NoiseTable(NamedTuple):
    """Entries of process noise covariances, or of their factors, that are not always zero.

    positions: (i, j), j <= i, of each entry. entries: (E, K, runs or 1). which: (T,) the row for each step; the last
    row belongs to a pause between readings.
    """

    positions: tuple[tuple[int, int], ...]
    entries: Array
    which: Array


def noise_table(motion: Motion, control: Array, lapse: Array, pause: float, factors: bool) -> NoiseTable:
    """The table for commands (c, T, runs or 1) held for these lengths of time (T,) [s]."""
    cov, which = noises(motion, control, lapse, pause)
    if factors:
        cov = cholesky(cov)
    i, j = np.tril_indices(motion.noise_size)
    lower = cov[i, j]
    used = (lower != 0.0).any(axis=(1, 2))  # NaN counts as not zero
    positions = tuple(zip(i[used].tolist(), j[used].tolist(), strict=True))
    return NoiseTable(positions, np.ascontiguousarray(lower[used]), which)


def noises(motion: Motion, control: Array, lapse: Array, pause: float) -> tuple[Array, Array]:
    """Process noise covariances (q, q, K, runs or 1), and the index (T,) for each step; the last is for a pause.

    Steps of equal duration are evaluated together, as if they were runs.
    """
    c, steps, runs = control.shape
    q = motion.noise_size
    found: list[Array] = []
    which, count = np.zeros(steps, dtype=np.int64), 0
    order = np.argsort(lapse)
    for alike in np.split(order, np.flatnonzero(np.diff(lapse[order])) + 1):
        dt = float(lapse[alike[0]])
        if dt <= 0.0:
            continue  # no time passes, nothing moves
        cov = motion.noise_cov(control[:, alike[0]], dt)
        if cov.ndim > 2:  # it depends on the command
            cov = motion.noise_cov(control[:, alike].reshape(c, alike.size * runs), dt)
        same = cov.ndim == 2 or cov.shape[2] == 1
        found.append(cov.reshape(q, q, 1, 1) if same else cov.reshape(q, q, alike.size, runs))
        which[alike] = count if same else count + np.arange(alike.size)
        count += found[-1].shape[2]
    still = np.asarray(motion.noise_cov(np.zeros((c, 1)), pause)) if pause > 0.0 else np.zeros((q, q))
    found.append(still.reshape(q, q, 1, 1))
    most = max(cov.shape[3] for cov in found)
    return np.concatenate([np.broadcast_to(cov, (*cov.shape[:3], most)) for cov in found], axis=2), which
