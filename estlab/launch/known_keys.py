"""Every key that a command line could have meant."""

import contextlib
import re
from collections.abc import Iterator, Sequence

from estlab.config.locations import conf_folder, groups
from estlab.launch.quoting import elements, quoted

_MOST = 8  # values of swept groups that are examined


def known_keys(arguments: Sequence[str], wrong: str) -> list[str]:
    """The groups and keys of the configuration that the arguments compose without the wrong key.

    arguments: as Hydra received them. For a swept group, the keys of each choice are known.
    """
    from hydra import compose, initialize_config_dir
    from hydra.errors import HydraException
    from omegaconf import OmegaConf

    from estlab.config.build import key_paths

    ours = [f"+{group}" if group == "experiment" else group for group in groups() if not group.startswith("hydra/")]
    found: dict[str, None] = {}
    with initialize_config_dir(str(conf_folder()), version_base="1.3"):
        for words in _lines(arguments, wrong):
            # The typed words may contain further mistakes, so fewer and fewer are used.
            for taken in (words, [word for word in words if _is_choice(word)], []):
                with contextlib.suppress(HydraException):
                    config = compose("config", overrides=taken, return_hydra_config=wrong.startswith("hydra"))
                    found |= dict.fromkeys(key_paths(OmegaConf.to_container(config)))
                    break
    hydras = [group for group in groups() if group.startswith("hydra/")] if wrong.startswith("hydra") else []
    return [*ours, *hydras, *found]


def _is_choice(word: str) -> bool:
    return re.match(r"\+*(hydra\.searchpath|(hydra/)?[\w-]+(@[\w.-]+)?)=", word) is not None


def _lines(arguments: Sequence[str], wrong: str) -> Iterator[list[str]]:
    """The words without the wrong key, once with each value of a swept group."""
    folders = [word.partition("=")[2] for word in arguments if word.startswith("--config-dir=")]
    search = [f"hydra.searchpath=[{','.join(quoted(f'file://{folder}') for folder in folders)}]"] if folders else []
    words = [
        word
        for word in arguments
        if not word.startswith("-") and re.split("[=@]", word)[0].lstrip("+~") not in (wrong, "hydra.mode")
    ]
    swept = {word: elements(word.partition("=")[2]) for word in words if _is_choice(word) and "[" not in word}
    first = [f"{word.partition('=')[0]}={swept[word][0]}" if word in swept else word for word in words]
    yield [*search, *first]
    others = [(i, value) for i, word in enumerate(words) for value in swept.get(word, [])[1:]]
    for i, value in others[:_MOST]:
        yield [*search, *first[:i], f"{words[i].partition('=')[0]}={value}", *first[i + 1 :]]
