"""Tables as CSV files."""

import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, BinaryIO

if TYPE_CHECKING:
    from pandas import DataFrame

Table = Mapping[str, Any] | Sequence[Mapping[str, Any]]


def write_csv(by_filter: Mapping[str, Table], seed: int, stream: BinaryIO) -> None:
    """Write columns or rows of several filters one after another; the filter begins each line, the seed ends it."""
    import pandas as pd

    frames = []
    for name, table in by_filter.items():
        frame = pd.DataFrame(table)
        frame.insert(0, "filter", name)
        frame["seed"] = seed
        frames.append(frame)
    _write(stream, pd.concat(frames) if len(frames) > 1 else frames[0])


def write_rows(rows: Sequence[Mapping[str, Any]], seed: int, stream: BinaryIO) -> None:
    """Write one table by row, the seed last in each line."""
    import pandas as pd

    frame = pd.DataFrame(rows)
    frame["seed"] = seed
    _write(stream, frame)


def write_columns(columns: Mapping[str, Any], stream: BinaryIO) -> None:
    """Write one table by column."""
    import pandas as pd

    _write(stream, pd.DataFrame(columns))


def _write(stream: BinaryIO, frame: "DataFrame") -> None:
    """Numbers in full, so that they read back the same."""
    text = io.TextIOWrapper(stream, encoding="utf-8", newline="")
    frame.to_csv(text, index=False)
    text.flush()
    text.detach()
