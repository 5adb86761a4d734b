"""The UTIAS multi-robot text files: odometry, readings by barcode, truth, landmarks.

Leung, Halpern, Barfoot and Liu 2011, "The UTIAS multi-robot cooperative localization and mapping dataset".
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from estlab.datasets.clocks import in_order, one_remark
from estlab.datasets.data_files import DEFAULTS, Files, Options
from estlab.datasets.promises import Column, check_headings
from estlab.datasets.text_tables import format_table, place, read_table
from estlab.datasets.whole import write_text
from estlab.errors import UserError
from estlab.maths.space import Array

FIRST_LANDMARK = 6  # subjects 1 to 5 are robots

# The names of each file: some courses call odometry control.
LAYOUT = {
    "odometry": ("Odometry.dat", "Control.dat"),
    "measurement": ("Measurement.dat",),
    "groundtruth": ("Groundtruth.dat",),
    "landmark_groundtruth": ("Landmark_Groundtruth.dat",),
    "barcodes": ("Barcodes.dat",),
}
_COMMON = ("landmark_groundtruth", "barcodes")  # common to all robots
_TIME = Column("time")
_COLUMNS = {
    "odometry": (_TIME, Column("v"), Column("w", angle=True)),
    "measurement": (_TIME, Column("barcode"), Column("range", distance=True), Column("bearing", angle=True)),
    "groundtruth": (_TIME, Column("x"), Column("y"), Column("heading")),
    "landmark_groundtruth": tuple(
        Column(name, missing=name.startswith("sd")) for name in ("subject", "x", "y", "sd_x", "sd_y")
    ),
    "barcodes": (Column("subject"), Column("barcode")),
}
_WHOLE = {"measurement": slice(1, 2), "barcodes": slice(0, 2), "landmark_groundtruth": slice(0, 1)}


@dataclass(frozen=True)
class LandmarkRecording:
    """One robot's files.

    odometry: (N, 3) time [s], v [m/s], w [rad/s]. truth: (N, 4) time, x, y [m], heading [rad]; N = 0 without a file.
    reading_time: (N,); readings: (2, N) range [m], bearing [rad]; landmark_number: (N,) index into landmarks.
    landmarks: (2, L) [m]; subjects: (L,) their numbers; barcodes: (L,). paths: of the files, by kind.
    """

    odometry: Array
    truth: Array
    reading_time: Array
    readings: Array
    landmark_number: Array
    landmarks: Array
    subjects: Array
    barcodes: Array
    paths: Mapping[str, Path]
    remarks: tuple[str, ...] = ()

    @property
    def files(self) -> tuple[Path, ...]:
        """All of the files."""
        return tuple(self.paths.values())


def read(folder: Path, prefix: str, unknown_share: float, options: Options = DEFAULTS) -> LandmarkRecording:
    """Read one robot's files. Readings of other robots are left out; so is a limited share of unknown barcodes.

    Files common to all robots are found with the prefix or without it; the truth may be missing. Rows with repeated
    or backward times are left out, up to a share; readings may share a time.
    Raises UserError that names the file if one is missing or does not follow the layout.
    """
    paths, remarks = _paths(Files(folder, prefix, LAYOUT, options.names))
    tables = {kind: read_table(path, _COLUMNS[kind], timed=kind not in _COMMON) for kind, path in paths.items()}
    _check_values(paths, tables)
    codes = tables["measurement"][:, 1].astype(int)
    barcodes, landmarks = tables["barcodes"], tables["landmark_groundtruth"]
    subject_of = {int(code): int(subject) for subject, code in barcodes}
    index_of = {int(subject): i for i, subject in enumerate(landmarks[:, 0])}
    unplaced = [s for s in subject_of.values() if s >= FIRST_LANDMARK and s not in index_of]
    if unplaced:
        raise UserError(
            f"{paths['landmark_groundtruth']}: no row for subject {unplaced[0]}, which {paths['barcodes'].name} names"
        )
    remarks += _check_barcodes(paths["measurement"], paths["barcodes"], codes, set(subject_of), unknown_share)
    rows, notes = _ordered(paths, tables, options.clock_faults)
    odometry, truth = tables["odometry"][rows["odometry"]], np.empty((0, 4))
    if "groundtruth" in paths:
        truth = tables["groundtruth"][rows["groundtruth"]]
        check_headings(
            truth[:, 3], truth[:, 1], truth[:, 2], lambda i: place(paths["groundtruth"], int(rows["groundtruth"][i]))
        )
    measurement = tables["measurement"][rows["measurement"]]
    subjects = np.array([subject_of.get(int(code), 0) for code in measurement[:, 1]])
    kept = subjects >= FIRST_LANDMARK
    if not kept.any():
        raise UserError(
            f"{paths['measurement']}: no reading of a landmark; check that {paths['barcodes'].name} belongs "
            "to the same recording"
        )
    code_of = {subject: code for code, subject in subject_of.items()}
    return LandmarkRecording(
        odometry=odometry,
        truth=truth,
        reading_time=measurement[kept, 0],
        readings=measurement[kept, 2:].T,
        landmark_number=np.array([index_of[int(s)] for s in subjects[kept]]),
        landmarks=landmarks[:, 1:3].T,
        subjects=landmarks[:, 0].astype(int),
        barcodes=np.array([code_of.get(int(s), 0) for s in landmarks[:, 0]]),
        paths=paths,
        remarks=(*remarks, *one_remark(notes)),
    )


def write(recording: LandmarkRecording, folder: Path, prefix: str) -> list[Path]:
    """Write one robot's files. Returns the files written."""
    landmarks = np.column_stack([recording.subjects, recording.landmarks.T, np.zeros((recording.subjects.size, 2))])
    measurement = np.column_stack(
        [recording.reading_time, recording.barcodes[recording.landmark_number], recording.readings.T]
    )
    tables = {
        "odometry": ("Time [s]    forward velocity [m/s]    angular velocity [rad/s]", recording.odometry),
        "measurement": ("Time [s]    Subject # (its barcode)    range [m]    bearing [rad]", measurement),
        "groundtruth": ("Time [s]    x [m]    y [m]    orientation [rad]", recording.truth),
        "landmark_groundtruth": ("Subject #    x [m]    y [m]    x std-dev [m]    y std-dev [m]", landmarks),
        "barcodes": ("Subject #    Barcode #", np.column_stack([recording.subjects, recording.barcodes])),
    }
    return [
        write_text(
            folder / f"{prefix}{LAYOUT[kind][0]}",
            format_table(("Simulated by estlab simulate", header), rows.astype(float)),
        )
        for kind, (header, rows) in tables.items()
    ]


def _paths(files: Files) -> tuple[dict[str, Path], tuple[str, ...]]:
    """The files by kind, and a remark if there is no truth."""
    for kind in LAYOUT:
        files.alone(kind)
    paths = {kind: files.path(kind, kind in _COMMON) for kind in ("odometry", "measurement")}
    truth = files.find("groundtruth")
    if truth:
        paths["groundtruth"] = truth
    paths |= {kind: files.path(kind, kind in _COMMON) for kind in _COMMON}
    return paths, () if truth else (f"nothing is scored: {files.lacks('groundtruth')}",)


def _ordered(
    paths: Mapping[str, Path], tables: Mapping[str, Array], share: float
) -> tuple[dict[str, Array], tuple[str, ...]]:
    """For each table with times, the rows to keep, and remarks about the others."""
    rows: dict[str, Array] = {}
    notes: tuple[str, ...] = ()
    for kind, path in paths.items():
        if kind not in _COMMON:
            time = tables[kind][:, 0]
            rows[kind], time_notes = in_order(time, partial(place, path), share, repeats=kind == "measurement")
            notes += time_notes
            if rows[kind].size < 2 and kind != "measurement":
                raise UserError(f"{path}: only one row; at least two are needed to interpolate")
    return rows, notes


def _check_values(paths: Mapping[str, Path], tables: Mapping[str, Array]) -> None:
    for kind, columns in _WHOLE.items():
        numbers = tables[kind][:, columns]
        broken = ((numbers != np.rint(numbers)) | (np.abs(numbers) > 1e9)).any(axis=1)
        _refuse(paths[kind], broken, "a subject or barcode is not an integer")
    subjects = tables["landmark_groundtruth"][:, 0]
    robots = f"subjects 1 to {FIRST_LANDMARK - 1} are robots; number landmarks from {FIRST_LANDMARK}, in both files"
    _refuse(paths["landmark_groundtruth"], subjects < FIRST_LANDMARK, robots)
    again = _again(subjects)
    _refuse(paths["landmark_groundtruth"], again, "this subject already has a row; keep only one")
    again = _again(tables["barcodes"][:, 1])
    _refuse(paths["barcodes"], again, "this barcode already belongs to another subject; each needs its own")


def _refuse(path: Path, rows: Array, why: str) -> None:
    """Raise UserError for the first of these rows (N,), if there is one."""
    if rows.any():
        raise UserError(f"{place(path, int(rows.argmax()))}: {why}")


def _again(values: Array) -> Array:
    """(N,) true where a value occurred before."""
    again = np.ones(values.size, dtype=bool)
    again[np.unique(values, return_index=True)[1]] = False
    return again


def _check_barcodes(path: Path, barcodes: Path, codes: Array, known: set[int], unknown_share: float) -> tuple[str, ...]:
    unknown = np.flatnonzero([int(code) not in known for code in codes])
    if not unknown.size:
        return ()
    first = f"{place(path, int(unknown[0]))}: barcode {codes[unknown[0]]} is not in {barcodes.name}"
    if unknown.size > unknown_share * codes.size:
        raise UserError(
            f"{first} ({unknown.size} of {codes.size} readings have unknown barcodes); check the file, or "
            "raise scenario.unknown_barcodes"
        )
    return (f"{first}; left out, together with {unknown.size - 1} more of {codes.size} readings",)
