"""estlab's own flags of a sweep, --resume DIR and --dry-run, translated to words that Hydra accepts."""

from collections.abc import Sequence
from pathlib import Path

from estlab.errors import UserError
from estlab.launch.arguments import CONFIG_DIR, parted, prepared
from estlab.launch.path_arguments import home
from estlab.launch.quoting import elements, literal, quoted, unquoted

# Words of that sweep that no longer matter, or that say where it was.
_DONE_WITH = ("sweep.dir", "hydra.sweep.dir", "sweep.dry_run")


def without_own_flags(arguments: Sequence[str]) -> list[str]:
    """The arguments with --dry-run as a key, and --resume DIR replaced by the words of that sweep."""
    at = [i for i, word in enumerate(arguments) if word.partition("=")[0] == "--resume"]
    if not at:
        return _with_keys(arguments)
    _, equals, folder = arguments[at[0]].partition("=")
    more = _with_keys([*arguments[: at[0]], *arguments[at[0] + 1 + (not equals) :]])
    folder = folder if equals else "".join(arguments[at[0] + 1 : at[0] + 2])
    if not folder or len(at) > 1 or (folder.startswith("-") and not equals):
        raise UserError("--resume takes the directory of a sweep, once, as in estlab sweep --resume runs/latest")
    if place := next((word for word in more if _key(word) in ("sweep.dir", "hydra.sweep.dir")), ""):
        raise UserError(f"{place}: --resume already names the directory; leave one of them out")
    return [*_words_of(Path(home(folder)), more), *more]


def _with_keys(arguments: Sequence[str]) -> list[str]:
    return ["sweep.dry_run=true" if word == "--dry-run" else word for word in arguments]


def _words_of(sweep: Path, more: Sequence[str]) -> list[str]:
    """The words of the sweep in a directory, except those that are typed again."""
    from estlab.sweeps.allowed import refused
    from estlab.sweeps.state import plan_of

    plan = plan_of(sweep)
    typed_flags, typed = parted(more)
    folders = [Path(flag.partition("=")[2]) for flag in typed_flags if flag.startswith(CONFIG_DIR)]
    given = {_key(word) for word in typed}
    engine_too = "hydra/launcher" in given
    kept = [
        word
        for word in plan["arguments"]
        if _key(word) not in {*given, *_DONE_WITH} and not (engine_too and _key(word).startswith("hydra.launcher."))
    ]
    # The words must be harmless in the form in which Hydra receives them.
    flags, own = parted(prepared(["--multirun", *kept]))
    flags = [
        flag for flag in flags if flag not in ("-m", "--multirun") and not (folders and flag.startswith(CONFIG_DIR))
    ]
    if wrong := next(iter(flags), "") or refused(own, folders):
        raise UserError(
            f"{sweep}: {wrong} of its command is used only if you type it; if you trust it, add it to this "
            f"command, or type the whole command again with sweep.dir={sweep}"
        )
    if any(map(_is_relative, own)) and Path(plan["folder"]) != Path.cwd():
        raise UserError(f"{sweep}: its data.path is relative; resume it from the folder {plan['folder']}")
    return [*own, f"sweep.dir={quoted(literal(str(sweep.resolve())))}"]


def _key(word: str) -> str:
    return word.partition("=")[0].lstrip("+")


def _is_relative(word: str) -> bool:
    """Whether a word sets data.path to a path relative to the current folder."""
    values = elements(word.partition("=")[2]) if _key(word) == "data.path" else []
    return any(not Path(home(unquoted(value))).is_absolute() for value in values)
