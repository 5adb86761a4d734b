"""What docs/python.md and the notebooks show is true: their code runs, and the tables have the columns it lists."""

import asyncio
import json
import re
import shutil

import matplotlib
import matplotlib.pyplot as plt
import pytest

from estlab.api.tables import COLUMNS
from tests.conftest import ROOT

pytestmark = pytest.mark.slow

PAGE = (ROOT / "docs" / "python.md").read_text()
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
KINDS = {"text": str, "number": float, "numbers": float, "count": int, "counts": int, "bool": bool}


def test_the_code_of_the_page_runs_from_top_to_bottom(tmp_path, monkeypatch, folder):
    shutil.copytree(folder, tmp_path / "runs/one")
    (tmp_path / "runs/latest").symlink_to("one")
    monkeypatch.chdir(tmp_path)
    everything = {}
    for code in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL):
        exec(compile(code, "docs/python.md", "exec"), everything)
    assert everything["found"].mean.shape == (3, 50)
    assert abs(everything["mean"][0, 0]) < 1.0


def test_the_page_lists_the_columns_of_each_table_with_their_types():
    for line in re.findall(r"^\| `(\w+)` \| [^|]+ \| (`filter`[^|]+) \|$", PAGE, re.MULTILINE):
        listed, columns = {}, COLUMNS[f"{line[0]}.csv"]
        for part in line[1].split(";"):
            kind = KINDS.get(part.split("`")[-1].strip(), float)
            listed |= dict.fromkeys(re.findall(r"`([\w.]+)`", part), kind)
        others = set(listed) - set(columns)
        assert {name: listed[name] for name in columns} == columns
        assert others <= {"rmse.x", "anees"}
    assert len(re.findall(r"^\| `(\w+)` \| [^|]+ \| `filter`", PAGE, re.MULTILINE)) == 9


def cells(notebook):
    return [cell for cell in json.loads(notebook.read_text())["cells"] if cell["cell_type"] == "code"]


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_holds_no_output(notebook):
    for cell in cells(notebook):
        assert (cell["outputs"], cell["execution_count"]) == ([], None)


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_cells_of_a_notebook_run_where_a_loop_of_asyncio_does(notebook, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    matplotlib.use("agg")

    async def kernel():
        everything = {"__name__": "__main__"}
        for cell in cells(notebook):
            exec(compile("".join(cell["source"]), notebook.name, "exec"), everything)

    asyncio.run(kernel())
    plt.close("all")
    assert capsys.readouterr().err == ""
