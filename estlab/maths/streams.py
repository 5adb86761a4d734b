"""Random numbers by name: the name determines the numbers, not the time or place of the request."""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from estlab.earlier_names import renamed
from estlab.maths.seeding import seeded, seeds
from estlab.maths.space import Array


@renamed(draws="generators")
@dataclass(frozen=True)
class Streams:
    """Independent streams keyed by seed, owner, purpose and run number.

    Truth, readings, prior and each filter have their own streams. So every filter meets the same truth and readings,
    and run k is the same alone, in any block and on any worker.
    """

    seed: int
    owner: str

    def generator(self, purpose: str, run: int) -> np.random.Generator:
        """The stream for one purpose in one run."""
        (generator,) = self.generators(purpose, [run])
        return generator

    def normals(self, purpose: str, runs: Sequence[int], shape: tuple[int, ...]) -> Array:
        """Standard normal numbers (*shape, runs), each run from its own stream."""
        return np.ascontiguousarray(self.generators(purpose, runs).normals(shape))

    def generators(self, purpose: str, runs: Sequence[int]) -> "Generators":
        """The generators of several runs, for numbers that are drawn step by step."""
        return Generators(partial(seeded, self.seed, self._key(purpose), runs))

    def seeds(self, purpose: str, runs: Sequence[int]) -> Array:
        """What seeds the generators of several runs, (runs, 4) words of 64 bits."""
        return seeds(self.seed, self._key(purpose), runs)

    def _key(self, purpose: str) -> list[int]:
        digest = hashlib.sha256(f"{self.owner}/{purpose}".encode()).digest()
        return [int.from_bytes(digest[i : i + 4], "little") for i in range(0, 16, 4)]

    def uniforms(self, purpose: str, runs: Sequence[int], shape: tuple[int, ...]) -> Array:
        """Numbers uniform on [0, 1) of shape (*shape, runs), each run from its own stream."""
        return np.ascontiguousarray(self.generators(purpose, runs).uniforms(shape))


@renamed(of="take")
class Generators:
    """Random number generators of a batch of runs, each of which draws from its own stream.

    make: gives the runs' generators. They are made when first drawn from, and some filters never do.
    """

    def __init__(self, make: Callable[[], list[np.random.Generator]]) -> None:
        self._make = make

    @cached_property
    def _generators(self) -> list[np.random.Generator]:
        return self._make()

    def take(self, runs: Array) -> "Generators":
        """The generators of some of the runs, by their index in this batch."""
        return Generators(lambda: [self._generators[run] for run in runs])

    def __iter__(self) -> Iterator[np.random.Generator]:
        return iter(self._generators)

    def normals(self, shape: tuple[int, ...]) -> Array:
        """Standard normal numbers (*shape, runs), each run's side by side in memory."""
        numbers = np.empty((len(self._generators), *shape))
        for k, generator in enumerate(self._generators):
            generator.standard_normal(out=numbers[k, ...])
        return np.moveaxis(numbers, 0, -1)

    def uniforms(self, shape: tuple[int, ...]) -> Array:
        """Numbers uniform on [0, 1) of shape (*shape, runs), each run's side by side in memory."""
        numbers = np.empty((len(self._generators), *shape))
        for k, generator in enumerate(self._generators):
            generator.random(out=numbers[k, ...])
        return np.moveaxis(numbers, 0, -1)


Draws = Generators  # its earlier name, for plugins
