"""Files with one element per frame: which frames to keep, and the truth that belongs to them."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from estlab.datasets.clocks import in_order, long_steps
from estlab.datasets.truth import on_timeline
from estlab.errors import UserError
from estlab.maths.space import Array

_OTHER_RATE = 20.0  # times or one part in so many: more than a robot's rate differs
_SAME = 1e-6  # [s] within which two times are equal
_BRIDGED = 1.5  # times the truth's step; no interpolation over a longer gap


@dataclass(frozen=True)
class Kept:
    """The frames (N,) that are kept, their times [s], and whether the times come from the file."""

    frames: Array
    time: Array
    timed: bool
    remarks: tuple[str, ...]


def kept(count: int, time: Array | None, otherwise: Array, place: Callable[[int], str], share: float) -> Kept:
    """The frames in the order of their times; without times, all frames at default times."""
    if time is None:
        return Kept(np.arange(count), otherwise, False, ())
    frames, time_notes = in_order(time, place, share)
    step, usual = (float(np.median(np.diff(t))) if t.size > 1 else np.nan for t in (time[frames], otherwise))
    if max(step / usual, usual / step) > _OTHER_RATE:
        time_notes += (f"{place(0)}: times are {step:.3g} s apart, scenario.dt is {usual:g}; are they in seconds?",)
    return Kept(frames, time[frames], True, (*time_notes, *long_steps(time[frames])))


def truth_of(
    data: Path, frames: Kept, path: Path, states: Array, time: Array | None, angles: tuple[int, ...], share: float
) -> tuple[Array, tuple[str, ...]]:
    """The truth (n, N) of the frames kept, from states (n, M); NaN where unknown.

    Matched by time if both files have times, otherwise by number. Raises UserError if the truth is known at no time.
    """
    remarks: tuple[str, ...] = ()
    if time is not None and frames.timed:
        order, remarks = in_order(time, lambda i: f"{path}: element {i + 1}", share)
        truth, by = _at_times(frames.time, time[order], states[:, order], angles), "time"
        if np.isnan(truth).any(axis=0).all() and np.isfinite(states).any():
            raise UserError(f"{path}: its times t are not those of {data.name}; both must hold the same steps")
    else:
        truth, by = np.full((states.shape[0], frames.time.size), np.nan), "number"
        there = frames.frames < states.shape[1]
        truth[:, there] = states[:, frames.frames[there]]
    truth[:, np.isnan(truth).any(axis=0)] = np.nan
    unknown = int(np.isnan(truth[0]).sum())
    if unknown or states.shape[1] != frames.time.size:
        remarks += (
            f"{path}: {states.shape[1]} states for the {frames.time.size} frames of {data.name}, matched by {by}; "
            f"truth is unknown in {unknown} frames",
        )
    return truth, remarks


def missing(where: Callable[[int], str], lost: Array, what: str) -> tuple[str, ...]:
    """A remark about the frames (N,) that lack something.

    Raises UserError if all lack it.
    """
    if not lost.any():
        return ()
    if lost.all():
        raise UserError(f"{where(0)}: no {what} in any of {lost.size} frames")
    first = int(lost.argmax())
    return (f"{where(first)}: no {what} in {int(lost.sum())} of {lost.size} frames, this is the first",)


def _at_times(time: Array, known: Array, states: Array, angles: tuple[int, ...]) -> Array:
    if known.size == 1:
        return np.where(np.abs(time - known) <= _SAME, states, np.nan)
    nearest = np.clip(np.searchsorted(known, time), 1, known.size - 1)
    nearest -= time - known[nearest - 1] < known[nearest] - time
    at = np.where(np.abs(known[nearest] - time) <= _SAME, known[nearest], time)
    return on_timeline(at, known, states, angles, _BRIDGED * float(np.median(np.diff(known))))
