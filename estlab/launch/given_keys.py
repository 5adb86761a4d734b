"""The keys that a command line and its experiment's file state: none of them is ever ignored."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from estlab.errors import UserError

# For simulated data only, and what does the same for a recording.
_INSTEAD = {
    "scenario.duration": "steps=N takes the first N steps",
    "scenario.dropped": "dropped=0.5 drops half of the readings",
}

# Words that turn off an experiment's own expectations, which belong to the data that its file runs on.
_OTHER_DATA = ("data=files", "data.source=files")


def other_data(words: Iterable[str]) -> bool:
    """Whether words choose a recording in place of the data of an experiment's file."""
    return any(word.lstrip("+").removesuffix(".yaml") in _OTHER_DATA for word in words)


def experiment_file(choice: str, folders: Sequence[Path]) -> Mapping[str, Any]:
    """The statements of an experiment's own file, as plain data; empty if there is no such file."""
    from omegaconf import OmegaConf

    path = Path("experiment", choice.removesuffix(".yaml") + ".yaml")
    found = next((folder / path for folder in folders if (folder / path).is_file()), None)
    content = OmegaConf.to_container(OmegaConf.load(found)) if found else None
    return {str(key): value for key, value in content.items()} if isinstance(content, Mapping) else {}


def refuse_unread(unread: Mapping[str, str], words: Iterable[str], experiment: Mapping[str, Any]) -> None:
    """Raise UserError for a given key that nothing would read.

    unread: the keys that this run does not read, with what would. words: the typed words.
    """
    typed = [(word.lstrip("+"), word.lstrip("+").partition("=")[0]) for word in words if "=" in word]
    stated = [(f"{key}={value} of the experiment", key) for key, value in _leaves(experiment, "")]
    for word, path in [*typed, *stated]:
        for key, reader in unread.items():
            if f"{path}.".startswith(f"{key}."):
                instead = _INSTEAD.get(key, "leave it out")
                raise UserError(f"{word} would not be read: it belongs to {reader}; {instead}")


def refuse_single_filter(words: Iterable[str], filters: Iterable[str]) -> None:
    """Raise UserError for a key of a single filter if there are several."""
    names = list(filters)
    for word in words:
        if names and word.lstrip("+").startswith("filter."):
            key = word.lstrip("+").partition("=")[0].removeprefix("filter.")
            raise UserError(
                f"{word} would not be used, because there are several filters; write filters.<{'|'.join(names)}>.{key}"
            )


def _leaves(node: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    """The statements of a file, by dotted path."""
    for key, value in node.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
