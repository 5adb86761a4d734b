"""Angles in configuration as people write them: ``${deg:40}`` is 40 degrees, in radians."""

import math
import re
from collections.abc import Mapping
from typing import Any

_WRITTEN = re.compile(r"\$\{deg:\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)\s*\}", re.IGNORECASE | re.ASCII)


def radians(*values: object) -> float:
    """The angle of so many degrees [rad], for ``${deg:...}``. Raises ValueError if it is not a number."""
    if len(values) == 1 and isinstance(values[0], int | float) and not isinstance(values[0], bool):
        return math.radians(values[0])
    written = ",".join("" if value is None else str(value) for value in values)
    raise ValueError(f"${{deg:{written}}} must be a number of degrees, such as ${{deg:40}}")


def is_angle(text: str) -> bool:
    """Whether a text is only an angle in degrees."""
    return _WRITTEN.fullmatch(text.strip()) is not None


def resolved(node: Any) -> Any:
    """Plain data with each angle in degrees converted to radians."""
    if isinstance(node, Mapping):
        return {key: resolved(value) for key, value in node.items()}
    if isinstance(node, list):
        return [resolved(value) for value in node]
    written = _WRITTEN.fullmatch(node.strip()) if isinstance(node, str) else None
    return math.radians(float(written[1])) if written else node
