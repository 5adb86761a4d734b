"""Readings in the shape that compiled code takes: one at a time, or all readings of a step as one."""

from dataclasses import dataclass

import numpy as np

from estlab.maths.space import Array
from estlab.record import Readings


@dataclass(frozen=True)
class Stack:
    """Readings of ``count`` slots each.

    step: (K,). values: (count * m, K, runs), NaN in an empty slot. landmark_number: (count, K, runs).
    reading, slot: the stacked reading and the slot of each of the original readings (N,).
    """

    count: int
    step: Array
    values: Array
    landmark_number: Array
    reading: Array
    slot: Array

    def apart(self, stacked: Array) -> Array:
        """The results for the stacked readings (count * m, K, runs), rearranged for the original ones (m, N, runs)."""
        parts = stacked.reshape(self.count, -1, *stacked.shape[1:])
        return np.moveaxis(parts[self.slot, :, self.reading], 1, 0)


def in_rows(array: Array) -> Array:
    """Numbers (n, T, runs) whose every component lies in one stretch, as they are or copied."""
    alike = array.dtype == np.float64 and array[:1].flags.c_contiguous and array.flags.aligned
    return array if alike else np.ascontiguousarray(array, dtype=float)


def one_by_one(readings: Readings, runs: int) -> Stack:
    """Each reading separately, for the first runs."""
    every = np.arange(readings.step.size)
    values = in_rows(readings.values[:, :, :runs])
    landmark_number = np.ascontiguousarray(readings.landmark_number[None, :, :runs], dtype=np.int64)
    return Stack(1, readings.step, values, landmark_number, every, np.zeros_like(every))


def stacked(readings: Readings, runs: int) -> Stack:
    """All readings of a step as one, for the first runs."""
    step, reading = np.unique(readings.step, return_inverse=True)
    slot = np.arange(reading.size) - np.searchsorted(reading, reading)
    count, m = int(slot.max(initial=0)) + 1, readings.values.shape[0]
    values = np.full((count, m, step.size, runs), np.nan)
    landmark_number = np.zeros((count, step.size, runs), dtype=np.int64)
    values[slot, :, reading] = np.moveaxis(readings.values[:, :, :runs], 1, 0)
    landmark_number[slot, reading] = readings.landmark_number[:, :runs]
    return Stack(count, step, values.reshape(count * m, step.size, runs), landmark_number, reading, slot)
