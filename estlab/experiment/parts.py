"""A part of an ensemble's blocks in a file, and all parts merged to what one process would have found."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from estlab.config.settings import Settings
from estlab.errors import UserError
from estlab.experiment.blocks import block_count
from estlab.experiment.monte_carlo import Ensemble, Totals, empty_totals
from estlab.maths.space import Array
from estlab.metrics.stored import below, comparison_arrays, comparison_of, tally_arrays, tally_of
from estlab.record import Record
from estlab.rundir import PART
from estlab.rundir.finished import stored


def save(ensemble: Ensemble, stream: BinaryIO) -> None:
    """Write the sums of a part's blocks, its time and, for the part that has them, the histories kept."""
    arrays: dict[str, Array] = {f"seconds/{name}": np.array(spent) for name, spent in ensemble.seconds.items()}
    for (level, number), totals in ensemble.blocks.nodes.items():
        node = f"nodes/{level}.{number}"
        for name, tally in totals.tallies.items():
            arrays |= {f"{node}/tallies/{name}/{key}": array for key, array in tally_arrays(tally)}
        arrays |= {f"{node}/comparison/{key}": array for key, array in comparison_arrays(totals.comparison)}
        arrays |= {f"{node}/runs/{key}": array for key, array in totals.each_run.runs.items()}
        for name, answers in totals.each_run.answers.items():
            arrays |= {f"{node}/answers/{name}/{key}": array for key, array in answers.items()}
        arrays |= {f"{node}/sums/{key}": array for key, array in totals.sums.items()}
    for name, kept in ensemble.kept.items():
        arrays |= {f"kept/{name}/{key}": array for key, array in kept.items()}
    np.savez(stream, allow_pickle=False, **arrays)


def put_together(settings: Settings, first: Record, folders: Sequence[Path]) -> Ensemble:
    """The ensemble whose parts are in these folders. first: the first block's record.

    Raises UserError that names the file if a part is missing, cannot be read or belongs to another ensemble.
    """
    ensemble = Ensemble(first)
    for folder in folders:
        try:
            _take(settings, ensemble, stored(folder, PART))
        except (UserError, ValueError, KeyError) as error:
            raise UserError(f"{folder / PART}: not a part of this ensemble ({error}); run that part again") from error
    whole = block_count(settings)
    found = sum(1 << level for level, _ in ensemble.blocks.nodes)
    if found != whole:
        raise UserError(f"{folders[0].parent}: its parts contain {found} of {whole} blocks; run the others too")
    return ensemble


def _take(settings: Settings, ensemble: Ensemble, arrays: dict[str, Array]) -> None:
    for name, spent in below(arrays, "seconds").items():
        ensemble.seconds[name] = ensemble.seconds.get(name, 0.0) + float(spent)
    for name in dict.fromkeys(key.split("/")[0] for key in below(arrays, "kept")):
        ensemble.kept[name] = below(arrays, f"kept/{name}")
    nodes = below(arrays, "nodes")
    for node in dict.fromkeys(key.split("/")[0] for key in nodes):
        level, number = (int(word) for word in node.split("."))
        ensemble.blocks.add(level, number, _totals(settings, ensemble.record, below(nodes, node)))


def _totals(settings: Settings, first: Record, arrays: dict[str, Array]) -> Totals:
    tallies = below(arrays, "tallies")
    names = list(dict.fromkeys(key.split("/")[0] for key in tallies))
    empty = empty_totals(settings, first, names)
    filled = {name: tally_of(empty.tallies[name], below(tallies, name)) for name in names}
    answers = {name: below(arrays, f"answers/{name}") for name in names}
    each_run = replace(empty.each_run, runs=below(arrays, "runs"), answers=answers)
    comparison = comparison_of(empty.comparison, below(arrays, "comparison"))
    return Totals(filled, comparison, each_run, below(arrays, "sums"))
