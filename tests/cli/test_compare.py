"""Runs side by side: what is paired is what met the same truth; what is broken is said, and the others go on."""

import csv
import io
import os
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from estlab.cli.main import main
from estlab.comparison.rows import labelled, rows_of
from estlab.report import overlay
from estlab.rundir.finished import read
from tests.cli.finished import edit, made


@pytest.fixture(scope="module")
def shelf(tmp_path_factory) -> Path:
    """Runs made once for all tests, which copy them."""
    folder = tmp_path_factory.mktemp("shelf")
    made(folder / "both", "filter=[ekf,ukf]")
    made(folder / "ekf", "filter=ekf")
    made(folder / "ukf", "filter=ukf", "noise.filter.process_scale=2", "runs=9")
    made(folder / "seed", "filter=ekf", "seed=2")
    return folder


@pytest.fixture(autouse=True)
def _in_a_folder_with(shelf, tmp_path, _in_an_empty_folder):
    for run in shelf.iterdir():
        if not run.is_symlink():
            shutil.copytree(run, tmp_path / run.name)


def table(capsys, *words: str) -> list[dict[str, str]]:
    """The rows that --csv - writes."""
    assert main(["compare", *words, "--csv", "-"]) == 0
    return list(csv.DictReader(io.StringIO(capsys.readouterr().out)))


def test_runs_made_apart_differ_by_what_the_same_filters_differ_by_in_one_run(capsys):
    made(Path("alone"), "filter=ukf")
    apart = table(capsys, "ekf", "alone", "--against", "alone", "--metric", "rmse")[0]
    together = pd.read_csv("both/comparison.csv").set_index("component")
    for component in ("x", "y", "heading", "position"):
        line = together.loc[component]
        for ours, theirs in (("", "difference"), (".low", "ci_low"), (".high", "ci_high"), (".wins", "wins")):
            assert float(apart[f"difference.{component}{ours}"]) == pytest.approx(line[theirs], rel=1e-9)
        assert float(apart[f"difference.{component}.p_holm"]) == pytest.approx(line["p"], rel=1e-9)
        assert float(apart[f"difference.{component}.n"]) == 12


def test_pairs_are_of_the_runs_that_both_have_and_p_is_adjusted_for_the_rows(capsys):
    rows = table(capsys, "ekf", "ukf", "both")
    assert [row["label"] for row in rows] == ["ekf ekf", "ukf runs=9 noise.filter.process_scale=2", "ekf both", "ukf"]
    assert [row["difference.position.n"] for row in rows] == ["", "9", "12", "12"]
    assert float(rows[2]["difference.position"]) == 0.0
    each = [pd.read_csv(f"{name}/runs.csv")["rmse.position"].to_numpy()[:9] for name in ("ukf", "ekf")]
    rmse = [np.sqrt((one**2).mean()) for one in each]
    assert float(rows[1]["difference.position"]) == pytest.approx(rmse[0] - rmse[1])
    assert rows[2]["difference.position.p_holm"] == "", "what is the same is not tested"
    p = [float(table(capsys, "ekf", *row)[-1]["difference.position.p_holm"]) for row in (["ukf"], ["both"])]
    # Holm 1979: the smallest of two times two, the other at least that.
    smaller = min(1.0, 2 * min(p))
    adjusted = [smaller if one == min(p) else max(one, smaller) for one in p]
    assert [float(rows[i]["difference.position.p_holm"]) for i in (1, 3)] == pytest.approx(adjusted)


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("seed=3",), "seed 1 and 3"),
        (("noise.truth.process_scale=2",), "noise.truth.process_scale 1 and 2"),
        (("steps=20",), "steps 25 and 20"),
        (("scenario=field",), "scenario landmark and field"),
    ],
)
def test_where_truth_is_not_shared_nothing_is_paired_and_it_is_said_why(words, why, capsys):
    made(Path("other"), "filter=ukf", *words)
    rows = table(capsys, "other", "ekf")
    assert rows[1]["not_paired"] == f"truth or readings differ: {why}"
    assert rows[1].get("difference.position", "") == ""
    assert main(["compare", "other", "ekf"]) == 0
    printed = capsys.readouterr()
    assert f"row 2 not paired with row 1: truth or readings differ: {why}" in printed.out
    key = why.split()[0]
    assert re.search(rf"^estlab: warning: .*{key if key in ('seed', 'scenario') else 'the truth'}", printed.err, re.M)


def test_what_only_the_filter_sees_of_a_scenario_leaves_the_truth_shared(capsys):
    made(Path("stacked"), "filter=ekf", "scenario.update=stacked")
    rows = table(capsys, "ekf", "stacked")
    assert rows[1]["difference.position.n"] == "12"
    assert rows[1]["label"] == "ekf scenario.update=stacked"


def test_repeats_of_one_recording_have_a_difference_and_no_interval(capsys):
    assert main(["simulate", "scenario=landmark", "steps=25", "data.path=recorded"]) == 0
    capsys.readouterr()
    for name in ("ekf", "ukf"):
        made(Path("runs") / name, f"filter={name}", "data=files", "data.path=recorded")
    first, second = table(capsys, "runs")
    assert float(second["difference.position"]) != 0.0
    assert second["difference.position.low"] == second["difference.position.p_holm"] == first["rmse.position.low"] == ""
    with open("recorded/Measurement.dat", "a") as stream:
        stream.write("\n")
    made(Path("runs/after"), "filter=ckf", "data=files", "data.path=recorded")
    assert "data files" in table(capsys, "runs")[2 if Path("runs/after") < Path("runs/ekf") else 1]["not_paired"]


def test_warnings_are_a_line_each_and_units_that_differ_stand_in_the_cells(capsys):
    metrics = Path("seed/metrics.csv")
    metrics.write_text(re.sub(r"(rmse,position),m,", r"\1,km,", metrics.read_text()))
    edit(Path("seed/run.json"), estlab="9.9")
    assert main(["compare", "ekf", "seed"]) == 0
    out, err = capsys.readouterr()
    assert err.splitlines() == [
        "estlab: warning: seed differs: 1 (row 1), 2 (row 2)",
        "estlab: warning: estlab differs: 0.1.0 (row 1), 9.9 (row 2)",
        "estlab: warning: unit of rmse position differs: m (row 1), km (row 2)",
    ]
    assert re.search(r"\] m .*\n2 .*\] km ", out)
    assert main(["compare", "ekf", "both"]) == 0
    assert capsys.readouterr().err == ""


def test_runs_that_are_not_whole_are_listed_and_left_out(capsys):
    edit(Path("seed/status.json"), status="failed", error="the disk was full")
    edit(Path("ukf/status.json"), status="running", pid=2**22 + 1)
    Path("both/status.json").write_text("{")
    assert main(["compare", "."]) == 0
    out, err = capsys.readouterr()
    assert err.splitlines() == [
        "estlab: both/status.json: cannot be read as JSON",
        "estlab: seed: left out, failed: the disk was full",
        "estlab: ukf: left out, unfinished, and its process is gone",
    ]
    assert out.splitlines()[0].startswith("landmark · 1 run directory")
    assert main(["compare", "seed", "ukf"]) == 1
    assert capsys.readouterr().err.splitlines()[-1] == "estlab: no run can be compared"


def test_a_run_that_did_not_find_what_was_expected_is_whole(capsys):
    assert main(["run", "scenario=landmark", "steps=25", "runs=3", "plots=false", "expect.diverged=3"]) == 1
    assert main(["compare", "runs"]) == 0
    assert "0 of 3" in capsys.readouterr().out


def test_words_name_runs_folders_links_and_patterns_and_each_run_counts_once(capsys):
    Path("runs/day/sweep").mkdir(parents=True)
    for number, name in ((10, "ekf"), (2, "ukf")):
        Path(name).rename(f"runs/day/sweep/{number}_{name}")
    Path("runs/day/sweep/attempts").mkdir()
    Path("seed").rename("runs/day/sweep/attempts/0_seed.1")
    Path("runs/latest").symlink_to("day/sweep")
    for words in (["runs"], ["runs/latest"], ["runs/*/*/*_?k?"], ["runs", "runs/day", "runs/day/sweep/2_ukf"]):
        found = [Path(row["directory"]).name for row in table(capsys, *words)]
        assert found == ["2_ukf", "10_ekf"]


def test_metrics_are_chosen_and_columns_follow(capsys):
    rows = table(capsys, "--metric", "rmse.x", "ekf", "--metric=inside_3sigma")
    metrics = [name for name in rows[0] if name.endswith(".low") and not name.startswith("difference")]
    assert metrics == [
        f"{m}.low" for m in ("rmse.x", *(f"inside_3sigma.{c}" for c in ("x", "y", "heading")), "inside_3sigma")
    ]
    line = pd.read_csv("ekf/metrics.csv").set_index(["metric", "component"]).loc[("rmse", "x")]
    assert float(rows[0]["rmse.x"]) == line["value"]
    assert float(rows[0]["rmse.x.high"]) == line["ci_high"]


def test_markdown_and_latex_have_every_row_and_escape_what_would_steer_them(capsys, tmp_path):
    Path("ekf").rename("a_b [x](y) $^2 %&|#{~<i>\x1b[31m")
    Path("both").rename("c")
    words = ["compare", "a_b*", "c"]
    assert main([*words, "--md"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "1 | ekf a\\_b [x]\\(y) $^2 %&amp;\\|#{\\~&lt;i>�[31m |" in lines[4]
    assert {len(re.findall(r"(?<!\\)\|", line)) for line in lines[2:7]} == {8}
    assert main([*words, "--latex"]) == 0
    out = capsys.readouterr().out
    name = (
        r"1 & ekf a\_b {[}x{]}(y) \$\textasciicircum{}2 \%\&\textbar{}\#\{\textasciitilde{}\textless{}i\textgreater{}"
    )
    assert name in out
    assert "\x1b" not in out
    assert out.count(r"\begin{tabular}") == out.count(r"\end{tabular}") == out.count(r"\toprule") == 2
    body = out.split(r"\midrule")[1].split(r"\bottomrule")[0].strip().splitlines()
    assert len(body) == 3
    assert all(len(re.findall(r"(?<!\\)&", line)) == 6 and line.endswith(r"\\") for line in body)
    assert main([*words]) == 0
    assert "\x1b" not in capsys.readouterr().out


def test_csv_goes_to_a_file_beside_the_table_and_no_cell_is_a_formula(capsys):
    text = Path("ekf/metrics.csv").read_text()
    Path("ekf/metrics.csv").write_text(text.replace(",m,", ",=1+1,"))
    assert main(["compare", "ekf", "--csv", "table.csv"]) == 0
    assert "RMSE position" in capsys.readouterr().out
    assert next(csv.DictReader(io.StringIO(Path("table.csv").read_text())))["rmse.position.unit"] == "'=1+1"


def test_the_overlay_has_a_curve_a_row_in_every_panel_and_a_legend_that_names_them(capsys):
    assert main(["compare", "both", "ukf", "--plot", "a.png"]) == 0
    assert Path("a.png").read_bytes().startswith(b"\x89PNG")
    rows = labelled([row for name in ("both", "ukf") for row in rows_of(read(Path(name)))])
    curves, unread = overlay.curves_of(rows)
    assert not unread
    figure = overlay.draw(curves, ["position"])
    panels = figure.get_axes()
    assert [axes.get_ylabel() for axes in panels] == ["RMSE x [m]", "RMSE y [m]", "RMSE heading [rad]", "NEES / n"]
    errors = pd.read_csv("ukf/errors.csv").query("component == 'y'")
    np.testing.assert_array_equal(panels[1].get_lines()[2].get_ydata(), errors["rmse"])
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert legend[:3] == ["1 ekf", "2 ukf", "3 ukf runs=9 noise.filter.process_scale=2"]
    assert [axes.get_ylabel() for axes in overlay.draw(curves, ["y"]).get_axes()] == ["RMSE y [m]", "NEES / n"]
    Path("ukf/errors.csv").write_bytes(b"\0\1")
    assert main(["compare", "both", "ukf", "--plot", "a.svg"]) == 0
    assert "estlab: ukf/errors.csv: " in capsys.readouterr().err


def _link(file: Path) -> None:
    file.unlink()
    file.symlink_to("/etc/passwd")


def _pipe(file: Path) -> None:
    file.unlink()
    os.mkfifo(file)


def _text(content: str | bytes):
    return lambda file: file.write_bytes(content if isinstance(content, bytes) else content.encode())


PYTHON = "!!python/object/apply:os.system ['touch ran']"
HOSTILE = {
    "a link that leads out": ("metrics.csv", _link, "is a link, which is not followed"),
    "a link to itself": ("metrics.csv", lambda f: (f.unlink(), f.symlink_to(f.name)), ""),
    "a pipe": ("metrics.csv", _pipe, "is not a regular file"),
    "a folder": ("run.json", lambda f: (f.unlink(), f.mkdir()), "is not a regular file"),
    "no file": ("config.yaml", Path.unlink, "no such file"),
    "no text": (
        "metrics.csv",
        _text(b"filter,metric,component,unit,value,ci_low,ci_high,n\n\xff\0"),
        "is not a table of a run",
    ),
    "words for numbers": (
        "metrics.csv",
        lambda f: f.write_text(f.read_text().replace("anees,all,,", "anees,all,,x")),
        "is no",
    ),
    "a column less": ("metrics.csv", _text("filter,metric\nekf,rmse\n"), "has no column component"),
    "no line": ("metrics.csv", _text("filter,metric,component,unit,value,ci_low,ci_high,n\n"), "contains no line"),
    "half a record": ("run.json", _text('{"names": '), "cannot be read as JSON"),
    "a deep record": ("run.json", _text("[" * 100_000), "cannot be read as JSON"),
    "a list": ("run.json", _text("[]"), "was not written by a run"),
    "no names": ("run.json", _text("{}"), "lacks the names of scenario"),
    "a name that is a path": (
        "run.json",
        lambda f: edit(f, names={"scenario": "../../x", "filter": "ekf"}),
        "is not the name",
    ),
    "an object of Python": ("config.yaml", _text(f"scenario: {PYTHON}\n"), "cannot be read as plain YAML"),
    "an alias": ("config.yaml", _text("a: &a [1]\nb: [*a, *a]\n"), "cannot be read as plain YAML"),
    "a deep configuration": ("config.yaml", _text("[" * 5000), "cannot be read as plain YAML"),
    "a large configuration": ("config.yaml", _text("a: 1\n" + "#" * 2**19), "larger than any file of a run"),
    "no configuration": ("config.yaml", _text("3\n"), "is not a run's configuration"),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_a_hostile_or_broken_directory_is_one_line_and_the_others_go_on(case, capsys):
    file, spoil, why = HOSTILE[case]
    spoil(Path("seed") / file)
    assert main(["compare", "ekf", "seed"]) == 0
    out, err = capsys.readouterr()
    assert re.fullmatch(rf"estlab: seed/{re.escape(file)}: .*{re.escape(why)}.*\n", err)
    assert "1 run directory" in out
    assert not Path("ran").exists()
    assert main(["compare", "seed"]) == 1


def test_a_broken_table_of_runs_leaves_the_rows_and_says_what_is_not_paired(capsys):
    Path("ukf/runs.csv").write_text("filter,run\nukf,0\n")
    assert main(["compare", "ekf", "ukf", "both"]) == 0
    out, err = capsys.readouterr()
    assert err == "estlab: ukf/runs.csv: lacks one of the columns run, truth_mark, readings_mark\n"
    assert "row 2 not paired with row 1: no runs.csv for ukf" in out
    assert "ekf both" in out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "takes run directories"),
        (["nowhere"], "there is no nowhere"),
        (["ekf", "--metrc", "x"], "has no --metrc; did you mean --metric?"),
        (["ekf", "--metric"], "--metric takes a value"),
        (["ekf", "--metric="], "--metric takes a value, got ''"),
        (["ekf", "--csv", "--md"], "--csv takes a file"),
        (["ekf", "--m=rmse"], "has no --m"),
        (["ekf", "--metric", "rmse.z"], "no run has it"),
        (["ekf", "--against", "7"], "no such row; give a number from 1 to 1"),
        (["ekf", "both", "--against", "ekf"], "matches rows 1, 2"),
        (["ekf", "--plot", "a.exe"], "must end in .png, .pdf, .svg"),
        (["ekf", "--md", "--latex"], "choose one"),
        (["ekf", "--csv", "-", "--md"], "both go to standard output"),
    ],
)
def test_a_mistake_is_one_line_and_code_2(words, said, capsys):
    assert main(["compare", *words]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert re.fullmatch(rf"estlab: [^\n]*{re.escape(said)}[^\n]*\n", err)
