"""Simulated data in a problem's original file layout."""

import contextlib
import tempfile
from pathlib import Path

from estlab.config.settings import Settings
from estlab.errors import UserError
from estlab.experiment.monte_carlo import record_of
from estlab.experiment.plugin_errors import plugins_named


@plugins_named
def simulate(settings: Settings) -> list[Path]:
    """Write simulated data of run 0 in the scenario's original file layout to data.path. Returns the files."""
    if settings.data.source != "simulated":
        raise UserError("estlab simulate makes data: leave data=simulated, and set data.path to the folder to write to")
    if settings.dropped:
        raise UserError(
            f"dropped={settings.dropped:g} applies to runs, but the files contain every reading; leave it out"
        )
    if not settings.data.path:
        raise UserError(
            f"data.path is required: the folder to write to, for example data.path=data/{settings.names.scenario}"
        )
    folder = Path(settings.data.path)
    record = record_of(settings, range(1))
    ours = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # All files are first written beside their places: a full disk or an existing file leaves nothing half done.
        with tempfile.TemporaryDirectory(dir=folder, prefix=".simulated-") as aside:
            written = settings.scenario.write(record, Path(aside), settings.data.prefix)
            taken = [path.name for path in written if (folder / path.name).exists()]
            if taken:
                raise UserError(
                    f"{folder / taken[0]}: already exists; remove it, or choose another data.path or data.prefix"
                )
            return [path.rename(folder / path.name) for path in written]
    except OSError as error:
        raise UserError(f"{folder}: cannot be written ({error.strerror}); choose another data.path") from error
    finally:
        if ours:
            with contextlib.suppress(OSError):
                folder.rmdir()  # empty, because nothing was written; otherwise it stays
