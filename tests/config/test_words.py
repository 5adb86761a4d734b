"""What is typed reaches Hydra as it was meant: paths with any signs, values of any size, misspelt names."""

import copy
import math
import os
import re
from pathlib import Path

import hypothesis.strategies as st
import pytest
from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser
from hypothesis import given
from omegaconf import OmegaConf

from estlab.cli.main import main
from estlab.config.build import build
from estlab.config.locations import conf_folder
from estlab.config.settings import Names
from estlab.errors import UserError
from estlab.experiment.compatibility import check
from estlab.launch import composition, yaml_bounds
from estlab.launch.arguments import prepared
from estlab.launch.path_arguments import PATHS, as_typed, quoted_path
from estlab.launch.quoting import elements, literal, quoted, unquoted
from estlab.sweeps.plan import MOST, combinations
from tests.conftest import composed as plain
from tests.conftest import options

SIGNS = st.lists(st.sampled_from(["${", *"ab \\'\",=:#$%{}[]()~\t\n.*é日/"]), max_size=12).map("".join)
STRANGE = [
    "my run, v=2 [a]",
    "it's",
    'a "b"',
    "a\\b",
    "tail\\",
    "$x",
    "#1:2",
    "ä é 日",
    "007",
    "1e3",
    "true",
    "a}b",
    "{a}",
]


def parsed(word: str):
    return OverridesParser.create().parse_override(word).value()


@given(SIGNS)
def test_a_quoted_text_is_that_text_to_hydra_and_to_us(text):
    assert parsed(f"key={quoted(text)}") == text
    assert unquoted(quoted(text)) == text


@given(SIGNS, st.sampled_from("'\""))
def test_what_hydra_takes_for_a_quoted_value_is_read_as_it_reads_it(text, quote):
    word = f"{quote}{text.replace(quote, '')}{quote}"
    try:
        meant = parsed(f"key={word}")
    except Exception:
        return
    assert unquoted(word) == meant


@given(SIGNS)
def test_a_literal_text_has_no_interpolation(text):
    assert OmegaConf.create({"key": literal(text)}).key == text


@given(st.lists(SIGNS, min_size=1, max_size=4))
def test_commas_part_values_but_for_those_in_quotes(texts):
    assert [unquoted(one) for one in elements(",".join(map(quoted, texts)))] == texts


@pytest.mark.parametrize("key", PATHS)
@pytest.mark.parametrize("path", STRANGE)
def test_a_path_is_taken_as_typed_by_every_key_that_is_one(key, path):
    (word,) = prepared([f"{key}={path}"])
    assert parsed(word) == path
    assert prepared([word]) == [word], "what is in quotes already stays so"
    assert as_typed(word) == f"{key}={path}"


@pytest.mark.parametrize(
    "word", ["data.path=null", "data.prefix=", "data.path=???", "filter=a,b", "~output", "data=x y"]
)
def test_what_is_no_path_is_left_to_hydra(word):
    assert quoted_path(word, sweep=False) == quoted_path(word, sweep=True) == word


def test_in_a_sweep_commas_part_the_values_of_data_path_unless_there_is_such_a_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert prepared(["-m", "data.path=a b,c"])[-1] == "data.path='a b','c'"
    assert prepared(["-m", "data.path='a,b',c d"])[-1] == "data.path='a,b','c d'"
    assert prepared(["-m", "data.path=choice(a,b)"])[-1] == "data.path=choice(a,b)"
    assert prepared(["-m", "output=a,b"])[-1] == "output='a,b'"
    assert prepared(["data.path=a b,c"])[-1] == "data.path='a b,c'"
    Path("a b,c").mkdir()
    assert prepared(["-m", "data.path=a b,c"])[-1] == "data.path='a b,c'"


def composed(*words: str):
    composition.install()
    with initialize_config_dir(str(conf_folder()), version_base="1.3"):
        return compose("config", overrides=prepared(list(words)), return_hydra_config=True)


def test_a_leading_tilde_is_the_home_wherever_the_path_is_written(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", "/somebody's home")
    config = composed("output=~/runs", "data.path=~", "sweep.dir=~/x y", "hydra.run.dir=~/${seed}")
    assert config.output == "/somebody's home/runs"
    assert config.data.path == "/somebody's home"
    assert config.sweep.dir == "/somebody's home/x y"
    assert config.hydra.run.dir == "/somebody's home/1"
    assert composed("output=./~").output == "./~"
    assert composed("output=~nobody-of-this-name/x").output == "~nobody-of-this-name/x"
    Path(tmp_path / "experiment").mkdir()
    Path(tmp_path / "experiment/mine.yaml").write_text("# @package _global_\noutput: ~/theirs\n")
    assert composed(f"hydra.searchpath=[file://{tmp_path}]", "+experiment=mine").output == "/somebody's home/theirs"
    (flag,) = prepared(["--config-dir=~/conf"])
    assert flag == "--config-dir=/somebody's home/conf"


def test_flags_go_first_with_their_values_wherever_they_stand():
    assert prepared(["seed=1", "--config-dir", "a=b", "steps=2", "-m", "-c", "job"]) == [
        "--config-dir=a=b", "-m", "--cfg=job", "expect=null", "expect_files=null", "report=false", "seed=1", "steps=2",
    ]  # fmt: skip
    assert prepared(["-i", "defaults", "seed=1"]) == ["--info=defaults", "seed=1"]
    assert prepared(["-i", "seed=1"]) == ["--info=all", "seed=1"]


@pytest.mark.parametrize(
    ("word", "message"),
    [
        (f"seed={'[' * 4000}", "brackets lie more than 20 deep"),
        (f"seed={'{a:' * 4000}", "brackets lie more than 20 deep"),
        (f"seed={'str(' * 4000}", "brackets lie more than 20 deep"),
        (f"output={'${' * 4000}", "brackets lie more than 20 deep"),
        (f"seed={'9' * 5000}", "the number is too large"),
    ],
)
def test_a_word_that_would_keep_the_parser_busy_is_refused(word, message):
    with pytest.raises(UserError, match=message):
        prepared([word])


LAUGHS = "a0: &a0 x\n" + "".join(f"a{i}: &a{i} [{','.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 9))
MERGES = "a0: &a0 {x: 1}\n" + "".join(f"a{i}: &a{i} {{<<: [{','.join([f'*a{i - 1}'] * 9)}]}}\n" for i in range(1, 9))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (LAUGHS, "stands for more than 100000 values"),
        (MERGES, "stands for more than 100000 values"),
        ("a: &a [*a]\n", r"the alias \*a refers to the value that contains it"),
        ("a: " + "[" * 90 + "]" * 90, "deep"),
        ("a: " + "[" * 90_000, "deep|nesting depth"),
        ("- " * 5000, "deep|nesting depth"),
        ("a: [1,\nb: 2\n", "line 3: is not YAML"),
        ("x" * 300_000, "is larger than any configuration"),
        ("a: \x00", "is not YAML"),
    ],
)
def test_a_file_of_configuration_that_is_a_bomb_is_refused_by_its_name(content, message, tmp_path):
    (tmp_path / "scenario").mkdir()
    (tmp_path / "scenario/bomb.yaml").write_text(content)
    with pytest.raises(UserError, match=rf"scenario/bomb.yaml: .*({message})"):
        composed(f"hydra.searchpath=[file://{tmp_path}]", "scenario=bomb")


def test_aliases_that_a_person_writes_are_fine(tmp_path):
    (tmp_path / "a.yaml").write_text("a: &a {x: 1, y: [1, 2]}\nb: *a\nc:\n  <<: *a\n  z: 3\n")
    yaml_bounds.checked(tmp_path / "a.yaml")
    (tmp_path / "b.yaml").write_bytes(b"a: \xff\xe4")
    with pytest.raises(UserError, match="is not text in UTF-8"):
        yaml_bounds.checked(tmp_path / "b.yaml")


def test_a_file_that_changed_is_read_anew_and_what_became_of_it_is_nobody_elses(tmp_path):
    composition.install()
    (tmp_path / "a.yaml").write_text("defaults: [b]\nx: 1\n")
    source = composition.FileConfigSource("mine", f"file://{tmp_path}")
    first, again = source.load_config("a"), source.load_config("a.yaml")
    del first.config["defaults"]
    assert again.config == {"defaults": ["b"], "x": 1}
    assert (again.provider, again.path) == ("mine", f"file://{tmp_path}")
    (tmp_path / "a.yaml").write_text("defaults: [b]\nx: 2\n")
    assert source.load_config("a").config == {"defaults": ["b"], "x": 2}


@pytest.mark.slow
def test_a_mode_that_a_file_of_the_users_states_counts(tmp_path, monkeypatch, capsys):
    """Wherever it lies; two seeds without it are refused."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine/experiment").mkdir(parents=True)
    (tmp_path / "mine/experiment/both.yaml").write_text("# @package _global_\nhydra: {mode: MULTIRUN}\n")
    up = os.path.relpath(tmp_path / "mine/experiment/both", conf_folder() / "experiment")
    words = ["seed=1,2", "runs=2", "steps=2", "sweep.dry_run=true"]
    for chosen in (
        ["--config-dir=mine", "+experiment=both"], ["hydra.searchpath=[file://mine]", "+experiment=both"],
        [f"+experiment={up}"], ["hydra.mode=MULTIRUN"], ["++hydra.mode=MULTIRUN"], ["++hydra={mode:MULTIRUN}"],
    ):  # fmt: skip
        assert main(["run", *chosen, *words]) == 0, chosen
        assert "seed=2" in capsys.readouterr().out
    assert main(["run", "+experiment=smoke", *words]) == 2


@pytest.mark.parametrize("path", sorted(conf_folder().rglob("*.yaml")), ids=lambda path: path.stem)
def test_no_file_of_ours_states_a_mode(path):
    """So it is not looked for in them (composition.Hydra)."""
    assert "mode" not in (OmegaConf.load(path).get("hydra") or {})
    assert not re.search(r"^# @package hydra *$", path.read_text(), re.MULTILINE)


def test_a_sweep_without_end_is_refused_before_it_is_written_out():
    with pytest.raises(UserError, match="a sweep has at most 1000000 jobs"):
        combinations({"a": ["1"] * 2000, "b": ["1"] * 2000}, [])
    assert MOST == 1_000_000


def test_a_folder_in_a_path_of_ours_is_never_an_interpolation(tmp_path):
    place = tmp_path / "a${seed}b"
    config = composed(f"hydra.sweep.dir={quoted(literal(os.fspath(place)))}")
    assert config.hydra.sweep.dir == str(place)


def numbers(node, path=()):
    """Each key that is a number, or numbers, by its path, and how many it has."""
    for key, value in node.items():
        if isinstance(value, dict):
            yield from numbers(value, (*path, key))
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield (*path, key), 0
        elif isinstance(value, list) and value and all(isinstance(one, int | float) for one in value):
            yield (*path, key), len(value)


PAIRS = [*((name, "ukf") for name in options("scenario")), *(("landmark", name) for name in options("filter"))]


@pytest.mark.slow
@pytest.mark.parametrize(("scenario", "name"), PAIRS)
def test_no_number_of_any_key_is_more_than_a_line(scenario, name):
    """Huge, negative, tiny, a part of one, not finite: taken, or refused with the key."""
    config = plain(f"scenario={scenario}", f"filter={name}")
    for path, count in numbers(config):
        for value in (1e30, -1e30, -1, 0, 0.5, math.nan, math.inf, 1e-300, 10**30, -(10**400)):
            changed = copy.deepcopy(config)
            node = changed
            for key in path[:-1]:
                node = node[key]
            node[path[-1]] = [value] * count if count else value
            try:
                check(build(changed, Names(scenario, name)))
            except UserError as error:
                assert "\n" not in str(error)
