"""estlab's own flags of a sweep, --resume DIR and --dry-run, as the words that Hydra takes."""

import re
from collections.abc import Sequence
from pathlib import Path

from estlab.errors import UserError

# A directory may come from a stranger. What these words do is done with his configuration or by his plugins, so
# whoever resumes must type them; the others choose among what estlab itself has.
_HIS_TO_TYPE = re.compile(
    r"[+~]*(plugins\b|hydra\.(?!job\.name=[\w.-]+$)|hydra/(?!launcher=\w+$|sweeper=optuna$)|-(?!-multirun$|m$))"
)
_ENGINE = re.compile(r"[+~]*hydra([./])launcher\b")


def without_own_flags(arguments: Sequence[str]) -> list[str]:
    """The arguments with --dry-run as a key, and --resume DIR as the words of the sweep there."""
    words = ["sweep.dry_run=true" if word == "--dry-run" else word for word in arguments]
    if "--resume" not in words:
        return words
    at = words.index("--resume")
    if at + 1 == len(words) or words[at + 1].startswith("-"):
        raise UserError("--resume takes the directory of a sweep, as in estlab sweep --resume runs/latest")
    return [*_words_of(Path(words[at + 1]), words[:at] + words[at + 2 :]), *words[:at], *words[at + 2 :]]


def _words_of(sweep: Path, more: Sequence[str]) -> list[str]:
    from estlab.sweeps.state import plan_of

    plan = plan_of(sweep)
    own = [word for word in plan["arguments"] if not word.startswith(("sweep.dir=", "sweep.dry_run="))]
    if any(_ENGINE.match(word) for word in more):
        own = [word for word in own if not _ENGINE.match(word)]
    if wrong := next((word for word in own if _HIS_TO_TYPE.match(word)), None):
        raise UserError(
            f"{sweep}: {wrong} of its command must be typed by who trusts it; "
            f"give its whole command again with sweep.dir={sweep}"
        )
    relative = any(re.match(r"[+]*data\.path=[^/]", word) for word in own)
    if relative and Path(plan["folder"]) != Path.cwd():
        raise UserError(f"{sweep}: its data.path is relative; resume it from {plan['folder']}")
    given = {word.partition("=")[0] for word in more}
    own = [word for word in own if not (word.startswith("sweep.") and word.partition("=")[0] in given)]
    place = str(sweep.resolve()).replace("'", "\\'")
    return [*(word for word in own if word not in ("-m", "--multirun")), f"sweep.dir='{place}'"]
