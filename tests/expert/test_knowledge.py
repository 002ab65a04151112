"""The shipped rules and the cases that prove them."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest
from mutation import survivors

from expert.engine import ENGINES, make_engine
from expert.facts import Vocabulary, vocabulary
from expert.rules.cases import case_directory, read_cases, run_cases
from expert.rules.check import check_rules
from expert.rules.coverage import coverage
from expert.rules.load import LoadedRules, load_rules, shipped_file
from expert.rules.margin import has_boundary
from modules.catalog import operators, probes

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def words() -> Vocabulary:
    return vocabulary(probes().values())


@pytest.fixture(scope="module")
def loaded(words: Vocabulary) -> LoadedRules:
    return load_rules(None, words, operators(), probes())


@pytest.mark.parametrize("engine", ENGINES)
def test_every_shipped_case_passes(engine, loaded, words):
    results = run_cases(loaded, make_engine(engine, words), words)
    assert results
    assert not [str(result) for result in results if not result.passed]


def test_the_cases_exercise_every_rule_condition_and_action(loaded, words):
    engine = make_engine("compiled", words)
    files, _ = read_cases(loaded.merged, words)
    found = coverage(loaded, engine, run_cases(loaded, engine, words), files, words)
    assert found.complete, "\n".join(found.lines())


def test_every_shipped_rule_has_at_least_three_cases(loaded, words):
    files, problems = read_cases(loaded.merged, words)
    assert not problems
    counts = {file.rule: len(file.cases) for file in files}
    assert not [rule.id for rule in loaded.base.rules if counts.get(rule.id, 0) < 3]


def test_a_boundary_case_is_named_as_one(loaded, words):
    results = run_cases(loaded, make_engine("compiled", words), words)
    wanted = {rule.id for rule in loaded.base.rules if has_boundary(rule, words)}
    named = {item.rule for item in results if item.boundary and re.search(r"exactly", item.case)}
    assert sorted(wanted - named) == []


def test_every_case_of_a_rule_has_a_name_of_its_own(loaded, words):
    files, _ = read_cases(loaded.merged, words)
    names = Counter((file.rule, case.name) for file in files for case, _ in file.cases)
    assert [name for name, count in names.items() if count > 1] == []


def test_every_firing_case_says_what_to_expect(loaded, words):
    files, _ = read_cases(loaded.merged, words)
    assert [(file.rule, case.name) for file in files for case, _ in file.cases if case.fires and not case.expect] == []


def test_every_case_file_belongs_to_a_shipped_rule(loaded):
    assert {path.stem for path in case_directory().iterdir()} == {rule.id for rule in loaded.base.rules}


def test_the_shipped_rules_have_no_problems(words):
    assert [str(problem) for problem in check_rules(None, words, operators(), probes())] == []


def test_every_rule_id_is_written_once():
    path = shipped_file()
    assert path is not None
    ids = re.findall(r"^  - id: (\S+)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    assert len(ids) > 40
    assert [name for name, count in Counter(ids).items() if count > 1] == []


def test_every_file_that_a_rule_refers_to_exists(loaded):
    files = {
        name
        for rule in loaded.base.rules
        for reference in rule.references
        for name in re.findall(r"\b(?:examples|benchmarks|docs)/[\w/]+\.\w+", reference)
    }
    assert "examples/evidence/facts.py" in files
    assert sorted(name for name in files if not (ROOT / name).is_file()) == []


def test_every_small_change_of_a_rule_makes_a_case_fail():
    count, alive = survivors()
    assert count > 300
    assert alive == []
