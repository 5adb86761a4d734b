"""Tables as CSV files."""

import io
from collections.abc import Mapping, Sequence
from typing import Any, BinaryIO


def write_csv(stream: BinaryIO, columns: Mapping[str, Any] | Sequence[Mapping[str, Any]], filter_name: str) -> None:
    """Write columns or rows as CSV, the filter's name first; numbers in full, so that they read back the same."""
    import pandas as pd

    frame = pd.DataFrame(columns)
    frame.insert(0, "filter", filter_name)
    text = io.TextIOWrapper(stream, encoding="utf-8", newline="")
    frame.to_csv(text, index=False)
    text.flush()
    text.detach()
