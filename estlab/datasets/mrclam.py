"""The UTIAS multi-robot text files: odometry, readings by barcode, truth, landmarks.

Leung, Halpern, Barfoot and Liu 2011, "The UTIAS multi-robot cooperative localization and mapping dataset".
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from estlab.datasets.tables import check_times, format_table, line_of_row, read_table
from estlab.datasets.whole import write_text
from estlab.errors import UserError
from estlab.maths.space import Array

FIRST_LANDMARK = 6  # subjects 1 to 5 are robots

_ODOMETRY = ("time", "v", "w")
_MEASUREMENT = ("time", "barcode", "range", "bearing")
_GROUNDTRUTH = ("time", "x", "y", "heading")
_LANDMARKS = ("subject", "x", "y", "sd_x", "sd_y")
_BARCODES = ("subject", "barcode")


@dataclass(frozen=True)
class Recording:
    """One robot's files.

    odometry: (N, 3) time [s], v [m/s], w [rad/s]. truth: (N, 4) time, x, y [m], heading [rad].
    reading_time: (N,); readings: (2, N) range [m], bearing [rad]; target: (N,) index into landmarks.
    landmarks: (2, L) [m]; subjects: (L,) their numbers; barcodes: (L,).
    """

    odometry: Array
    truth: Array
    reading_time: Array
    readings: Array
    target: Array
    landmarks: Array
    subjects: Array
    barcodes: Array
    files: tuple[Path, ...]
    remarks: tuple[str, ...] = ()


def read(folder: Path, prefix: str, unknown_share: float) -> Recording:
    """Read one robot's files. Readings of other robots are left out, and unknown barcodes up to a share of all.

    Files common to all robots are found with the prefix or without it.
    Raises UserError, naming the file, where one is missing or not as the layout says.
    """
    paths = {kind: _find(folder, prefix, kind) for kind in ("Odometry", "Measurement", "Groundtruth")}
    for kind in ("Landmark_Groundtruth", "Barcodes"):
        paths[kind] = _find(folder, prefix, kind, shared=True)
    odometry = read_table(paths["Odometry"], _ODOMETRY)
    measurement = read_table(paths["Measurement"], _MEASUREMENT)
    truth = read_table(paths["Groundtruth"], _GROUNDTRUTH)
    landmarks = read_table(paths["Landmark_Groundtruth"], _LANDMARKS)
    barcodes = read_table(paths["Barcodes"], _BARCODES)
    check_times(paths["Odometry"], odometry[:, 0])
    check_times(paths["Measurement"], measurement[:, 0], repeats=True)
    check_times(paths["Groundtruth"], truth[:, 0])

    _check_values(paths, odometry, measurement, truth, barcodes, landmarks)
    subject_of = {int(code): int(subject) for subject, code in barcodes}
    index_of = {int(subject): i for i, subject in enumerate(landmarks[:, 0])}
    unplaced = [s for s in subject_of.values() if s >= FIRST_LANDMARK and s not in index_of]
    if unplaced:
        raise UserError(
            f"{paths['Landmark_Groundtruth']}: no row for subject {unplaced[0]}, which {paths['Barcodes'].name} names"
        )
    codes = measurement[:, 1].astype(int)
    remarks = _check_barcodes(paths["Measurement"], paths["Barcodes"], codes, set(subject_of), unknown_share)
    subjects = np.array([subject_of.get(int(code), 0) for code in codes])
    kept = subjects >= FIRST_LANDMARK
    if not kept.any():
        raise UserError(
            f"{paths['Measurement']}: no reading of a landmark; check that {paths['Barcodes'].name} belongs to it"
        )
    code_of = {subject: code for code, subject in subject_of.items()}
    return Recording(
        odometry=odometry,
        truth=truth,
        reading_time=measurement[kept, 0],
        readings=measurement[kept, 2:].T,
        target=np.array([index_of[int(s)] for s in subjects[kept]]),
        landmarks=landmarks[:, 1:3].T,
        subjects=landmarks[:, 0].astype(int),
        barcodes=np.array([code_of.get(int(s), 0) for s in landmarks[:, 0]]),
        files=tuple(paths.values()),
        remarks=remarks,
    )


def write(recording: Recording, folder: Path, prefix: str) -> list[Path]:
    """Write one robot's files; the files written."""
    landmarks = np.column_stack([recording.subjects, recording.landmarks.T, np.zeros((recording.subjects.size, 2))])
    measurement = np.column_stack([recording.reading_time, recording.barcodes[recording.target], recording.readings.T])
    tables = {
        "Odometry": ("Time [s]    forward velocity [m/s]    angular velocity [rad/s]", recording.odometry),
        "Measurement": ("Time [s]    Subject # (its barcode)    range [m]    bearing [rad]", measurement),
        "Groundtruth": ("Time [s]    x [m]    y [m]    orientation [rad]", recording.truth),
        "Landmark_Groundtruth": ("Subject #    x [m]    y [m]    x std-dev [m]    y std-dev [m]", landmarks),
        "Barcodes": ("Subject #    Barcode #", np.column_stack([recording.subjects, recording.barcodes])),
    }
    return [
        write_text(
            folder / f"{prefix}{kind}.dat", format_table(("Simulated by estlab simulate", header), rows.astype(float))
        )
        for kind, (header, rows) in tables.items()
    ]


def _find(folder: Path, prefix: str, kind: str, shared: bool = False) -> Path:
    candidates = [folder / f"{prefix}{kind}.dat", *([folder / f"{kind}.dat"] if shared else [])]
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    if not folder.is_dir():
        raise UserError(f"data.path: no folder {folder}")
    if (folder / f"{prefix}Odometry.dat").is_file():
        raise UserError(f"{candidates[0]}: no such file; it belongs with {prefix}Odometry.dat")
    prefixes = sorted(p.name.removesuffix("Odometry.dat") for p in folder.glob("*Odometry.dat"))
    known = (
        f"set data.prefix to one of: {', '.join(repr(p) for p in prefixes)}"
        if prefixes
        else "the folder has no *Odometry.dat"
    )
    raise UserError(f"{candidates[0]}: no such file; {known}")


def _check_values(
    paths: dict[str, Path], odometry: Array, measurement: Array, truth: Array, barcodes: Array, landmarks: Array
) -> None:
    for kind, numbers in (
        ("Measurement", measurement[:, 1:2]),
        ("Barcodes", barcodes),
        ("Landmark_Groundtruth", landmarks[:, :1]),
    ):
        broken = ((numbers != np.rint(numbers)) | (np.abs(numbers) > 1e9)).any(axis=1)
        _refuse(paths[kind], broken, "a subject or barcode is not a whole number")
    _refuse(paths["Landmark_Groundtruth"], _again(landmarks[:, 0]), "this subject has a row already; leave one")
    _refuse(paths["Barcodes"], _again(barcodes[:, 1]), "this barcode is another subject's already; each needs its own")
    _refuse(
        paths["Measurement"], measurement[:, 2] < 0.0, f"range is negative; the columns are {' '.join(_MEASUREMENT)}"
    )
    for kind, table in (("Groundtruth", truth), ("Odometry", odometry)):
        if table.shape[0] < 2:
            raise UserError(f"{paths[kind]}: one row only; at least two are needed to know what is between them")


def _refuse(path: Path, rows: Array, why: str) -> None:
    """Raise UserError for the first of these rows (N,), if there is one."""
    if rows.any():
        raise UserError(f"{path}:{line_of_row(path, int(np.flatnonzero(rows)[0]))}: {why}")


def _again(values: Array) -> Array:
    """(N,) true where a value has been there before."""
    again = np.ones(values.size, dtype=bool)
    again[np.unique(values, return_index=True)[1]] = False
    return again


def _check_barcodes(path: Path, barcodes: Path, codes: Array, known: set[int], unknown_share: float) -> tuple[str, ...]:
    unknown = np.flatnonzero([int(code) not in known for code in codes])
    if not unknown.size:
        return ()
    first = f"{path}:{line_of_row(path, int(unknown[0]))}: barcode {codes[unknown[0]]} is not in {barcodes.name}"
    if unknown.size > unknown_share * codes.size:
        raise UserError(
            f"{first}, as for {unknown.size} of {codes.size} readings; check it, or raise scenario.unknown_barcodes"
        )
    return (f"{first}; left out, with {unknown.size - 1} more of {codes.size} readings",)
