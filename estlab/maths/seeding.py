"""Seeds the streams of many runs at once: NumPy's SeedSequence, with an array of run numbers as its last word.

O'Neill 2015, "Developing a seed_seq alternative"; the constants are those of NumPy's guaranteed algorithm.
"""

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from numpy.random.bit_generator import ISeedSequence

from estlab.maths.space import Array

_MIXED, _MIXED_BY = 0x43B0D7E5, 0x931E8875
_GIVEN, _GIVEN_BY = 0x8B51F9DD, 0x58F38DED
_LEFT, _RIGHT = np.uint32(0xCA01F9DD), np.uint32(0x4973F715)
_HALF = np.uint32(16)
_POOL, _WORD = 4, 2**32
_MANY = 4  # runs from which it is faster


class _Known(ISeedSequence):
    """The words that a generator takes as its seed."""

    def __init__(self, words: Array) -> None:
        self.words = words

    def generate_state(self, n_words: int, dtype: object = np.uint32) -> Array:
        """The words, in the number and width that PCG64 asks for."""
        return self.words


def seeded(seed: int, key: Sequence[int], runs: Sequence[int]) -> list[np.random.Generator]:
    """For each run the generator seeded by SeedSequence(seed, spawn_key=(*key, run)). key: words of 32 bits."""
    return [np.random.Generator(np.random.PCG64(cast(Any, _Known(own)))) for own in seeds(seed, key, runs)]


def seeds(seed: int, key: Sequence[int], runs: Sequence[int]) -> Array:
    """For each run four words of 64 bits (runs, 4), as SeedSequence(seed, spawn_key=(*key, run)) generates them."""
    if len(runs) < _MANY or min(runs) < 0 or max(runs) >= _WORD:
        each = (np.random.SeedSequence(seed, spawn_key=(*key, run)) for run in runs)
        return np.array([own.generate_state(_POOL, np.uint64) for own in each], dtype=np.uint64).reshape(-1, _POOL)
    before = np.random.SeedSequence(seed, spawn_key=tuple(key))
    # The first words take a factor each and the pool's own mixing 12; each word after them takes 4.
    further = max(0, -(-seed.bit_length() // 32) - _POOL) + len(key)
    taken = _POOL + 12 + _POOL * further
    return _words(before.pool, _MIXED * pow(_MIXED_BY, taken, _WORD) % _WORD, np.array(runs, dtype=np.uint32))


def _words(pool: Array, factor: int, last: Array) -> Array:
    """Four words of 64 bits (N, 4) for each last word of a key (N,)."""
    mixed = []
    for entry in pool[:, None]:
        word, factor = _hashed(last, factor, _MIXED_BY)
        word = _LEFT * entry - _RIGHT * word
        mixed.append(word ^ word >> _HALF)
    found, factor = np.empty((last.size, 2 * _POOL), dtype=np.uint32), _GIVEN
    for i in range(2 * _POOL):
        found[:, i], factor = _hashed(mixed[i % _POOL], factor, _GIVEN_BY)
    return found[:, ::2] + (found[:, 1::2].astype(np.uint64) << np.uint64(32))


def _hashed(word: Array, factor: int, by: int) -> tuple[Array, int]:
    """A word hashed, and the factor for the next."""
    after = factor * by % _WORD
    word = (word ^ np.uint32(factor)) * np.uint32(after)
    return word ^ word >> _HALF, after
