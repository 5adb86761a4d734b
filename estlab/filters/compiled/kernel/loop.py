"""The filter over time, one run after another, in numbers: what estlab.filters.loop and gaussian do, as it is compiled.

This text becomes part of a generated module (estlab.filters.compiled.source), which defines before it what is only
declared here: the models, and a transform, which is points or line.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from estlab.filters.compiled.kernel.small import cholesky
from estlab.filters.compiled.scalars import jit
from estlab.maths.space import Array

Numbers = tuple[float, ...]

N: int  # components of the state
M: int  # components of a reading
AT_REST: Numbers  # the command between interleaved readings
command: Callable[[Array, int, int], Numbers]  # at a step of a run
about: Callable[[Array, int], Numbers]  # the place of this number
wrap_state: Callable[[Array], None]  # brings angles back to half a turn
wrap_reading: Callable[[Array], None]
predicted_state: Callable[..., None]
predicted_reading: Callable[..., None]
room: Callable[[], Any]  # for what the transform computes


class Innovation(NamedTuple):
    """Room for an update."""

    residual: Array
    cov: Array
    cross: Array
    factor: Array
    gain: Array
    white: Array


def forward(
    first: int,
    last: int,
    lapse: Array,
    control: Array,
    noise: Array,
    which: Array,
    pause: float,
    bounds: Array,
    values: Array,
    target: Array,
    places: Array,
    reading_noise: Array,
    quantiles: Array,
    updating: bool,
    points: Any,
    mean: Array,
    cov: Array,
    means: Array,
    covs: Array,
    whitened: Array,
    log_scale: Array,
    gated: Array,
) -> None:
    """Steps ``first`` to ``last`` of all runs; the arrays are what its engine, CompiledLoop, gives.

    The beliefs mean (n, runs) and cov (n, n, runs) are those before, and become those after.
    """
    space = room()
    innovation = Innovation(
        np.empty(M), np.empty((M, M)), np.empty((N, M)), np.empty((M, M)), np.empty((M, N)), np.empty(M)
    )
    x, p, reading, white, log = np.empty(N), np.empty((N, N)), np.empty(M), np.empty(M), np.empty(M)
    for r in range(mean.shape[1]):
        commands, noises = min(r, control.shape[2] - 1), min(r, noise.shape[1] - 1)
        for a in range(N):
            x[a] = mean[a, r]
            for b in range(N):
                p[a, b] = cov[a, b, r]
        for k in range(first, last):
            if lapse[k] > 0.0:
                given = command(control, k, commands), lapse[k]
                predicted_state(x, p, given, noise[which[k], noises], points, space)
                wrap_state(x)
            for i in range(bounds[k], bounds[k + 1]):
                count = 0
                for a in range(M):
                    reading[a] = values[a, i, r]
                    count += not np.isnan(reading[a])
                if count == 0:
                    continue
                if pause > 0.0 and i > bounds[k]:
                    predicted_state(x, p, (AT_REST, pause), noise[-1, noises], points, space)
                    wrap_state(x)
                if updating:
                    place = (about(places, target[i, r]),)
                    predicted_reading(x, p, place, reading_noise, points, space, innovation)
                    gated[k, r] += update(x, p, reading, quantiles[count], innovation, white, log)
                    for a in range(M):
                        whitened[a, i, r], log_scale[a, i, r] = white[a], log[a]
            for a in range(N):
                means[a, k, r] = x[a]
                for b in range(N):
                    covs[a, b, k, r] = p[a, b]
        for a in range(N):
            mean[a, r] = x[a]
            for b in range(N):
                cov[a, b, r] = p[a, b]


@jit
def update(
    x: Array, p: Array, reading: Array, quantile: float, found: Innovation, whitened: Array, log_scale: Array
) -> int:
    """The one gain: the belief given a reading whose mean stands in ``found.residual``; whether it was refused.

    See estlab.filters.gaussian.GaussianFilter.condition.
    """
    residual, factor, gain, white = found.residual, found.factor, found.gain, found.white
    for a in range(M):
        residual[a] = reading[a] - residual[a]
    wrap_reading(residual)
    for a in range(M):
        if np.isnan(reading[a]):
            without(a, found)
    cholesky(found.cov, factor)
    nis = 0.0
    for a in range(M):
        for c in range(N):
            known = 0.0
            for b in range(a):
                known += factor[a, b] * gain[b, c]
            gain[a, c] = (found.cross[c, a] - known) / factor[a, a]
        known = 0.0
        for b in range(a):
            known += factor[a, b] * white[b]
        white[a] = (residual[a] - known) / factor[a, a]
        nis += white[a] * white[a]
    refused = nis > quantile
    for a in range(M):
        unused = refused or np.isnan(reading[a])
        whitened[a] = np.nan if unused else white[a]
        log_scale[a] = np.nan if unused else np.log(factor[a, a])
    if not refused:
        for c in range(N):
            for a in range(M):
                x[c] += gain[a, c] * white[a]
            for b in range(c + 1):
                less = 0.0
                for a in range(M):
                    less += gain[a, c] * gain[a, b]
                p[c, b] -= less
                p[b, c] = p[c, b]
    wrap_state(x)
    return 1 if refused else 0


@jit
def without(a: int, found: Innovation) -> None:
    """What was not measured is independent of the state, with no residual."""
    found.residual[a] = 0.0
    for c in range(N):
        found.cross[c, a] = 0.0
    for b in range(M):
        found.cov[a, b] = found.cov[b, a] = 0.0
    found.cov[a, a] = 1.0
