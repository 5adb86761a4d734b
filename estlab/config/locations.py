"""Where the shipped configuration is, and which options it and a user's own folder offer."""

from collections.abc import Sequence
from pathlib import Path


def conf_folder() -> Path:
    """conf/, next to the package in a checkout and inside it in an installed wheel."""
    package = Path(__file__).parents[1]
    inside = package / "conf"
    return inside if inside.is_dir() else package.parent / "conf"


def options(group: str, folders: Sequence[Path] = ()) -> dict[str, Path]:
    """The file of each option of a group by its name, sorted; folders: the user's own, in addition to conf/.

    If a name occurs twice, the file in conf/ counts, as in Hydra.
    """
    found: dict[str, Path] = {}
    for folder in (*folders, conf_folder()):
        place = folder / group
        found |= {str(path.relative_to(place).with_suffix("")): path for path in place.rglob("*.yaml")}
    return dict(sorted(found.items()))


def groups() -> list[str]:
    """The names of the groups of conf/, including Hydra's."""
    conf = conf_folder()
    return sorted({str(path.parent.relative_to(conf)) for path in conf.rglob("*.yaml") if path.parent != conf})
