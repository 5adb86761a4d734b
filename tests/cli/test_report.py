"""report.html: complete, the same when drawn again, safe whatever a directory holds."""

import errno
import json
import os
import shutil
import subprocess
import sys
from html import unescape
from pathlib import Path

import pandas as pd
import pytest

from estlab.cli.main import main
from estlab.report import page
from tests.html import Page

pytestmark = pytest.mark.slow

TINY = ["runs=4", "steps=15"]
RUN_FILES = ["config.yaml", "overrides.yaml", "run.json", "status.json", "log.txt", "metrics.csv", "tests.csv"]
RUN_FILES += ["verdicts.csv", "coverage.csv", "comparison.csv", "expectations.csv", "radar.csv"]
EVIL = '</td><script>window.pwned = 1</script><img src=x onerror="window.pwned = 1"> & \''


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A run with two filters, an expectation and a table of its own: every file that there may be."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    words = ["filter=[ekf,ukf]", *TINY, "expect.rmse.position.max=100", f"hydra.run.dir={folder}"]
    assert main(["run", "scenario=field", *words, f"output={folder.parent}"]) == 0
    (folder / "radar.csv").write_text("method,error\nukf,0.5\n")
    facts = json.loads((folder / "run.json").read_text())
    (folder / "run.json").write_text(json.dumps(facts | {"scenario": "radar"}))
    return folder


@pytest.fixture
def copy(whole):
    return Path(shutil.copytree(whole, "copy", ignore=shutil.ignore_patterns("report.html")))


def read(folder) -> Page:
    return Page((Path(folder) / "report.html").read_text(encoding="utf-8"))


def drawn(folder) -> Page:
    return Page(page.draw(Path(folder)))


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["scenario=field", "filter=[dead_reckoning,ekf]"], 0),
        (["filter=ekf", "smooth=true"], 0),
        (["plots=false", "expect.rmse.x.max=0"], 1),
        (["scenario=landmark", "data=files", "data.path=nowhere"], 2),
        (["run_index=3", "runs=100"], 0),
        (["scenario=radar"], 0),
    ],
)
def test_a_run_leaves_a_page_that_its_directory_alone_draws_again(words, code, capsys):
    assert main(["run", *TINY, *words, "hydra.run.dir=out", "output=."]) == code
    first = Path("out/report.html").read_bytes()
    read("out")
    Path("out/report.html").unlink()
    moved = Path("out").rename("elsewhere")
    capsys.readouterr()
    assert main(["report", "elsewhere"]) == 0
    assert capsys.readouterr().out == "elsewhere/report.html\n"
    assert (moved / "report.html").read_bytes() == first
    assert main(["report", "elsewhere/"]) == 0
    assert (moved / "report.html").read_bytes() == first, "the page that is there already changes nothing"


def test_the_page_says_what_each_metric_is(whole):
    rows = read(whole).tables["What each metric is"][1:]
    assert {row[0][0] for row in rows} == set(pd.read_csv(whole / "metrics.csv")["metric"])
    assert all(row[1][0] and row[2][0] for row in rows)


def test_the_page_has_every_figure_of_the_metrics_in_full(whole):
    table = pd.read_csv(whole / "metrics.csv")
    numbers = [row[4][1] for row in read(whole).tables["Every row of metrics.csv"][1:]]
    pd.testing.assert_series_equal(pd.Series(numbers, dtype=float, name="value"), table["value"], check_exact=True)


def test_the_page_says_what_ran_how_it_ended_and_what_was_found(whole):
    shown = drawn(whole)
    assert shown.texts["h1"] == ["field · ekf, ukf · 4 runs × 15 steps · seed 1"]
    verdicts = pd.read_csv(whole / "verdicts.csv")
    for name, word, sentence in verdicts[["filter", "word", "sentence"]].itertuples(index=False):
        (found,) = [text for text in shown.texts["li"] if f"{name} is {sentence}" in text]
        assert word in found.split()[1], "the word beside its sign, not its colour alone"
    assert "ok" in shown.texts["span"]
    expected = ["Verdicts", "Errors", "Is it consistent?", "Who is better?", "Coverage", "Expectations"]
    expected += ["The problem's own table", "Plots", "All metrics", "Configuration", "Provenance", "Files"]
    assert [heading for heading in shown.texts["h2"] if heading != "Warnings"] == expected
    assert len(shown.texts["figure"]) == len(list((whole / "plots").glob("*.png"))) > 2
    facts = {row[0][0] for row in shown.tables["What ran, on what, and how long"]}
    assert {"estlab", "python", "packages.numpy", "machine.cores", "command", "wall_time_s"} <= facts
    assert "process_scale: 1.0" in "".join(shown.texts["pre"])


def test_figures_have_the_digits_of_the_terminal(capsys):
    assert main(["run", "filter=ekf", *TINY, "hydra.run.dir=out", "output=."]) == 0
    printed = capsys.readouterr().out
    for row in read("out").tables["Root mean square errors over runs, with 95 % intervals"][1:]:
        (line,) = [line for line in printed.splitlines() if line.startswith(f"{row[0][0]} ")]
        assert line.split()[2] == row[1][0]
        assert row[2][0] in line


def test_a_run_that_found_what_was_not_expected_says_so_on_its_page():
    assert main(["run", "expect.rmse.x.max=0", "plots=false", *TINY, "hydra.run.dir=out", "output=."]) == 1
    shown = read("out")
    assert "unmet" in shown.texts["span"]
    assert any("1 of 1 expectation not met: rmse.x expected at most 0" in text for text in shown.texts["p"])
    assert any("✗ not met" in cell for row in shown.tables["What the run was expected to find"] for cell, _ in row)
    assert any("plots=true draws them" in text for text in shown.texts["p"])


def test_a_run_that_came_to_nothing_says_so_once():
    words = ["scenario=landmark", "data=files", "data.path=nowhere", "hydra.run.dir=out", "output=."]
    assert main(["run", *words]) == 2
    shown = read("out")
    assert shown.texts["h1"] == ["landmark · ukf · 1 run · seed 1"]
    assert "data.path: no folder nowhere" in shown.texts["p"]
    assert "The run ended before it had figures." in shown.texts["p"]
    assert not any("is missing" in said for said in shown.texts["p"])


def test_runs_write_no_page_where_none_is_asked_for():
    assert main(["run", "report=false", *TINY, "plots=false", "hydra.run.dir=out", "output=."]) == 0
    assert main(["sweep", "filter=ekf,ukf", *TINY, "plots=false", "hydra.sweep.dir=swept", "output=."]) == 0
    assert main(["verify", "smoke", "expect.diverged.max=3", "output=verified"]) == 0
    assert list(Path().rglob("report.html")) == [Path("swept/report.html")], "a sweep has one, its jobs have none"
    words = ["filter=ekf,ukf", *TINY, "plots=false", "report=true", "hydra.sweep.dir=asked", "output=."]
    assert main(["sweep", *words]) == 0
    assert len(list(Path("asked").rglob("report.html"))) == 3


def test_a_disk_without_room_for_the_page_does_not_spoil_the_run(monkeypatch, capsys):
    def full(path):
        raise OSError(errno.ENOSPC, "No space left on device", str(path / "report.html"))

    monkeypatch.setattr(page, "write", full)
    assert main(["run", *TINY, "plots=false", "hydra.run.dir=out", "output=."]) == 0
    assert json.loads(Path("out/status.json").read_text())["status"] == "ok"
    out = Path("out").resolve()
    remedy = f"the page is missing; draw it later with estlab report {out}"
    assert capsys.readouterr().err == f"estlab: {out}/report.html: No space left on device; {remedy}\n"


@pytest.mark.parametrize("name", RUN_FILES)
def test_whatever_one_file_is_the_rest_is_shown(copy, name):
    before = drawn(copy).texts["h2"]
    path = copy / name
    garbage = bytes(range(256)) * 40
    contents = [b"", b"\n", garbage, b"\xff\xfe" + garbage, b"nan" * 100, b'"', b"a,a\n1,2,3\n\n4\n", b"[" * 100_000]
    contents += [b"filter,metric,component,value,ci_low,ci_high,n\n" + b"x,rmse,x,inf,-inf,nan,1e999\n" * 3]
    contents += [b'{"status": {"a": [[[1]]]}, "filters": 3, "runs": [], "began": 7, "data": [1, {}], "title": {}}']
    contents += [b'{"title": "\\ud800", "data": {"a": 1}, "command": [1], "scenario": "\\u0000/../.."}']
    contents += [b"filter,found,met\n" + b"9" * 5000 + b",1e-320,True\n"]
    for content in contents:
        path.write_bytes(content)
        assert set(drawn(copy).texts["h2"]) >= set(before) - {"Warnings", "The problem's own table"}
    path.unlink()
    for make in (path.mkdir, lambda: os.mkfifo(path), lambda: path.symlink_to("nowhere"), lambda: None):
        make()
        assert drawn(copy).texts["h1"]
        if path.is_dir():
            path.rmdir()
        else:
            path.unlink(missing_ok=True)


def test_markup_in_any_file_is_shown_as_text(copy):
    for path in copy.iterdir():
        if path.suffix in (".csv", ".yaml", ".txt"):
            path.write_text(path.read_text().replace("ekf", EVIL.replace(",", "")))
    for name in ("run.json", "status.json"):
        facts = json.loads((copy / name).read_text())
        (copy / name).write_text(json.dumps(dict.fromkeys(facts, EVIL) | {EVIL: [EVIL]}))
    (copy / "log.txt").write_text(f"2026-01-01 00:00:00,000 WARNING {EVIL}\n")
    (copy / "plots" / "<img src=x onerror=alert(1)>.png").write_bytes(next((copy / "plots").glob("*.png")).read_bytes())
    (copy / "javascript:alert(1)").write_text("")
    markup = page.draw(copy)
    shown = Page(markup)
    assert len(shown.texts["script"]) == 1
    assert EVIL in shown.texts["h1"][0] and any(EVIL in text for text in shown.texts["li"])
    assert any(given.get("href") == "./javascript%3Aalert%281%29" for _, given in shown.elements)


def test_links_are_not_followed_out_of_the_directory(copy):
    secret = Path("secret")
    secret.mkdir()
    plot = next((copy / "plots").glob("*.png"))
    shutil.copy(plot, secret / "private.png")
    (secret / "words.csv").write_text("filter,metric,component,value\nprivate words,rmse,x,1\n")
    (copy / "plots" / "linked.png").symlink_to(secret.resolve() / "private.png")
    (copy / "metrics.csv").unlink()
    (copy / "metrics.csv").symlink_to(secret.resolve() / "words.csv")
    shown = drawn(copy)
    assert "plots/linked.png is a link, which is not followed." in shown.texts["p"]
    assert "metrics.csv is a link, which is not followed." in shown.texts["p"]
    assert "private" not in page.draw(copy)
    shutil.rmtree(copy / "plots")
    (copy / "plots").symlink_to(secret.resolve())
    shown = drawn(copy)
    assert "figure" not in shown.texts and "plots/ is a link, which is not followed." in shown.texts["p"]
    (copy / "report.html").symlink_to(secret.resolve() / "words.csv")
    assert main(["report", str(copy)]) == 0
    assert (secret / "words.csv").read_text().startswith("filter,"), "nor is anything written through one"
    Path("latest").symlink_to(copy)
    assert page.draw(Path("latest")) == page.draw(copy), "the directory that the user names may be one"
    assert not (copy / "report.html").is_symlink()


def test_a_huge_directory_makes_a_page_of_bounded_size(copy):
    line = "ekf,rmse,x,m,0.5,0.4,0.6,4,1\n"
    (copy / "metrics.csv").write_text("filter,metric,component,unit,value,ci_low,ci_high,n,seed\n" + line * 400_000)
    (copy / "log.txt").write_text("2026-01-01 00:00:00,000 WARNING again\n" * 400_000 + "the very end\n")
    (copy / "plots" / "large.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(9 * 2**20))
    (copy / "plots" / "words.png").write_text("<svg onload=alert(1)>")
    markup = page.draw(copy)
    shown = Page(markup)
    assert len(markup) < 6e6
    said = shown.texts["p"]
    assert "Only the first 5000 rows of metrics.csv are shown." in said
    assert "Only the last 128 kB of log.txt are shown." in said
    assert {
        "plots/large.png is too large and is left out.",
        "plots/words.png is not a PNG picture and is left out.",
    } < {*said}
    assert any(text.endswith("the very end\n") for text in shown.texts["pre"])


def test_nothing_that_a_directory_names_is_imported_or_run(copy):
    import pickle

    class Trap:
        def __reduce__(self):
            return os.mkdir, ("sprung",)

    Path("trap.py").write_text("import os; os.mkdir('sprung')")
    (copy / "config.yaml").write_text(
        "plugins: [trap]\nscenario: {_target_: trap.Trap}\nx: !!python/object/apply:os.mkdir [sprung]\ny: ${now:}\n"
    )
    (copy / "estimates.npz").write_bytes(pickle.dumps(Trap()))
    code = (
        "import sys; from estlab.cli.main import main; main(['report', 'copy']); print(sorted(m for m in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not Path("sprung").exists()
    assert not {"trap", "yaml", "pickle5", "hydra", "omegaconf"} & set(done.stdout.split("'"))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "estlab report takes the directory of a run or a sweep, for example estlab report runs/latest"),
        (["copy", "nowhere"], "nowhere: no such directory"),
        (
            ["copy", "empty"],
            "empty: holds neither a run nor a sweep; name a directory that estlab run or estlab sweep made",
        ),
        (["copy", "--open"], "estlab report has no --open (see estlab report --help)"),
    ],
)
def test_a_mistake_is_one_line_and_draws_nothing(copy, words, said, capsys):
    Path("empty").mkdir()
    assert main(["report", *words]) == 2
    assert capsys.readouterr().err == f"estlab: {said}\n"
    assert not list(Path().rglob("report.html"))


def test_a_directory_that_cannot_be_written_is_said_in_one_line(copy, monkeypatch, capsys):
    def refuse(*_):
        raise OSError(errno.EACCES, "Permission denied", "copy/report.html")

    monkeypatch.setattr(page, "write_text", refuse)
    assert main(["report", "copy"]) == 1
    assert capsys.readouterr().err == "estlab: copy/report.html: Permission denied\n"


def test_help_is_light_and_directories_are_completed(copy, monkeypatch, capsys):
    code = (
        "import sys; from estlab.cli.main import main; main(['report', '--help']);"
        "print(sorted({'numpy', 'scipy', 'pandas', 'matplotlib', 'hydra', 'rich', 'yaml'} & set(sys.modules)))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.startswith("usage: estlab report DIR") and out.endswith("[]\n")
    for line, answer in [("co", "copy/"), ("copy/", "copy/plots/"), ("x", "")]:
        monkeypatch.setenv("COMP_LINE", f"estlab report {line}")
        assert main(["-sc", "query=bash"]) == 0
        assert capsys.readouterr().out == answer + "\n"


def sweep(folder: Path, jobs: dict[str, str], table: bool = True) -> Path:
    """A sweep's directory as docs/sweeps.md says it is: jobs by name with their status."""
    folder.mkdir()
    planned = [{"name": name, "values": {"filter": "ekf", "noise.filter.process_scale": "0.5"}} for name in jobs]
    (folder / "sweep.json").write_text(json.dumps({"arguments": ["filter=ekf", EVIL], "jobs": planned}))
    for name, word in jobs.items():
        if "/" not in name and word != "left":
            (folder / name).mkdir()
            (folder / name / "status.json").write_text(json.dumps({"status": word}))
    if table:
        rows = [
            {"job": name, "noise.filter.process_scale": 0.5, "filter": "ekf", "status": word, "wall_time_s": 1.25}
            | {"rmse.position": 0.1234, "rmse.position.low": 0.12, "rmse.position.high": 0.13, "verdict": "consistent"}
            for name, word in jobs.items()
        ]
        pd.DataFrame(rows).to_csv(folder / "sweep.csv", index=False)
        failed = [
            {"job": n, "attempt": 1, "status": w, "error": EVIL, "directory": "x"}
            for n, w in jobs.items()
            if w == "failed"
        ]
        pd.DataFrame(failed, columns=["job", "attempt", "status", "error", "directory"]).to_csv(
            folder / "failures.csv", index=False
        )
    return folder


def test_a_sweep_has_a_page_with_its_jobs_and_failures(capsys):
    folder = sweep(Path("swept"), {"0_car_ekf": "ok", "1_car_ekf": "failed", "2_car_ekf": "left", "../../etc": "ok"})
    (folder / "0_car_ekf" / "report.html").write_text("a page")
    assert main(["report", "swept"]) == 0
    shown = read("swept")
    assert shown.texts["h1"] == ["sweep · 4 jobs · filter × noise.filter.process_scale"]
    assert next(text for text in shown.texts["p"] if "ok" in text).split() == ["ok", "2", "failed", "1", "left", "1"]
    links = [given["href"] for name, given in shown.elements if name == "a" and given["href"].startswith("./")]
    assert links[:3] == ["./1_car_ekf/", "./0_car_ekf/report.html", "./1_car_ekf/"], "none to what is not there"
    assert not any(".." in link for link in links)
    jobs = shown.tables["Jobs; every metric is in sweep.csv"]
    assert jobs[1][5:8] == [("0.1234", "0.1234"), ("0.1200 to 0.1300", "0.12"), ("consistent", None)]
    assert any(EVIL in cell for row in shown.tables["Each attempt that failed, with its error"] for cell, _ in row)


def test_a_sweep_that_was_cut_off_shows_what_its_jobs_say():
    folder = sweep(Path("swept"), {"0_car_ekf": "ok", "1_car_ekf": "running", "2_car_ekf": "left"}, table=False)
    rows = drawn(folder).tables["Jobs of the plan"]
    assert [(row[0][0], row[-1][0]) for row in rows[1:]] == [
        ("0_car_ekf", "ok"),
        ("1_car_ekf", "running"),
        ("2_car_ekf", "left"),
    ]
    for content in (
        b"",
        b"\xff{",
        b"[]",
        b'{"jobs": 3, "arguments": {}}',
        b'{"jobs": [1, {"name": ["x"], "values": [2]}]}',
    ):
        (folder / "sweep.json").write_bytes(content)
        assert drawn(folder).texts["h1"]


def test_escapes_are_undone_by_a_browser_to_what_was_written():
    from estlab.report.markup import tag, text

    assert unescape(text(EVIL)) == EVIL
    assert text("a\x00b\ud800c") == "a\ufffdb\ufffdc"
    assert tag("p", EVIL, ["<", None, tag("b", ">")], title='"') == f'<p title="&quot;">{text(EVIL)}&lt;<b>&gt;</b></p>'
