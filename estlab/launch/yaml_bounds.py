"""Checks a file of configuration before it is read: no short text may stand for an endless one."""

from pathlib import Path

from estlab.errors import UserError

_BYTES = 2**18
_NODES, _DEEPEST = 100_000, 50  # hundreds of times what a configuration has


def checked(path: Path) -> bytes:
    """The content of a YAML file, checked to be text, small, and small with its aliases expanded.

    Raises UserError that names the file and the line.
    """
    import yaml

    content = path.read_bytes()[: _BYTES + 1]
    if len(content) > _BYTES:
        raise UserError(f"{path}: is larger than any configuration ({_BYTES // 1024} kB)")
    try:
        _check_nodes(content.decode())
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: is not text in UTF-8") from error
    except ValueError as error:
        raise UserError(f"{path}: {error}") from error
    except yaml.YAMLError as error:
        mark, problem = getattr(error, "problem_mark", None), getattr(error, "problem", None)
        where = f"line {mark.line + 1}: " if mark else ""
        raise UserError(f"{path}: {where}is not YAML ({problem or ' '.join(str(error).split())})") from error
    return content


def _check_nodes(text: str) -> None:
    import yaml

    # The number of nodes in each open collection, its anchor, and the number of nodes that each anchor stands for.
    sizes: list[int] = [0]
    anchors: list[str | None] = [None]
    stands_for: dict[str | None, int] = {}
    for event in yaml.parse(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
        if isinstance(event, yaml.CollectionStartEvent):
            sizes.append(1)
            anchors.append(event.anchor)
        elif isinstance(event, yaml.CollectionEndEvent):
            size, anchor = sizes.pop(), anchors.pop()
            stands_for[anchor] = size
            sizes[-1] += size
        elif isinstance(event, yaml.ScalarEvent):
            stands_for[event.anchor] = 1
            sizes[-1] += 1
        elif isinstance(event, yaml.AliasEvent):
            if event.anchor in anchors:
                raise ValueError(f"the alias *{event.anchor} refers to the value that contains it")
            sizes[-1] += stands_for.get(event.anchor, 1)
        if len(sizes) > _DEEPEST:
            raise ValueError(f"is nested more than {_DEEPEST} deep")
        if sizes[-1] > _NODES:
            raise ValueError(f"stands for more than {_NODES} values, by its aliases")
