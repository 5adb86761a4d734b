"""The fixed reference of the particle filter's speed: plain NumPy, vectorised over the particles, one run at a time.

A bootstrap filter for a robot that hears its three nearest beacons, as one writes it who knows NumPy well and wants no
more than this filter: a cloud is an array (N, 3). It answers what estlab answers (mean, covariance, how each reading
fitted, effective sample size) and draws the same numbers in the same order. It is not to be made faster: it is what
estlab is measured against.
"""

from typing import Any, NamedTuple

import numpy as np

Array = np.ndarray[Any, np.dtype[Any]]


class Found(NamedTuple):
    """Means (T, 3), covariances (T, 3, 3), whitened innovations (T, 3) and effective sample sizes (T,)."""

    mean: Array
    cov: Array
    whitened: Array
    size: Array


class Problem(NamedTuple):
    """Corners low and high (3,) of where the robot may be; beacons (B, 2); standard deviations of noise and reading."""

    low: Array
    high: Array
    beacons: Array
    process_sd: Array
    reading_sd: Array


def bootstrap(problem: Problem, moved: Array, heard: Array, particles: int, rng: np.random.Generator) -> Found:
    """The estimates of one run from what was moved (T, 2), [ds dth], and heard (T, 3)."""
    steps = len(moved)
    found = Found(np.empty((steps, 3)), np.empty((steps, 3, 3)), np.empty((steps, 3)), np.empty(steps))
    reading_cov = np.diag(problem.reading_sd**2)
    cloud = problem.low + (problem.high - problem.low) * rng.random((3, particles)).T
    log_weights = np.full(particles, -np.log(particles))
    weights, size = np.exp(log_weights), float(particles)
    for k in range(steps):
        if size < 0.5 * particles:
            cloud = cloud[systematic(weights, rng)]
            log_weights = np.full(particles, -np.log(particles))
            weights = np.exp(log_weights)
        cloud = turned_and_moved(cloud, moved[k], rng.standard_normal((2, particles)).T * problem.process_sd)
        expected = nearest_ranges(cloud, problem.beacons)

        mean = weights @ expected
        spread = expected - mean
        factor = np.linalg.cholesky((weights[:, None] * spread).T @ spread + reading_cov)
        found.whitened[k] = np.linalg.solve(factor, heard[k] - mean)

        log_weights = log_weights - 0.5 * (((heard[k] - expected) / problem.reading_sd) ** 2).sum(axis=1)
        log_weights -= log_weights.max()
        weights = np.exp(log_weights)
        total = weights.sum()
        weights /= total
        log_weights -= np.log(total)
        size = 1.0 / (weights**2).sum()

        mean = weights @ cloud
        mean[2] = np.arctan2(weights @ np.sin(cloud[:, 2]), weights @ np.cos(cloud[:, 2]))
        spread = cloud - mean
        spread[:, 2] -= 2.0 * np.pi * np.rint(spread[:, 2] / (2.0 * np.pi))
        found.mean[k], found.cov[k], found.size[k] = mean, (weights[:, None] * spread).T @ spread, size
    return found


def turned_and_moved(cloud: Array, moved: Array, noise: Array) -> Array:
    """The cloud (N, 3) after a turn and a straight move with their noises (N, 2)."""
    heading = cloud[:, 2] + moved[1] + noise[:, 1]
    way = moved[0] + noise[:, 0]
    return np.column_stack([cloud[:, 0] + way * np.cos(heading), cloud[:, 1] + way * np.sin(heading), heading])


def nearest_ranges(cloud: Array, beacons: Array) -> Array:
    """Ranges (N, 3) to the three nearest beacons, ascending."""
    dx = cloud[:, :1] - beacons[:, 0]
    dy = cloud[:, 1:2] - beacons[:, 1]
    return np.sort(np.sqrt(dx * dx + dy * dy), axis=1)[:, :3]


def systematic(weights: Array, rng: np.random.Generator) -> Array:
    """Indices (N,), each N times its weight in the mean, by one random number."""
    edges = np.cumsum(weights)
    positions = (np.arange(weights.size) + rng.random(1)) / weights.size * edges[-1]
    return np.minimum(np.searchsorted(edges, positions, side="right"), weights.size - 1)
