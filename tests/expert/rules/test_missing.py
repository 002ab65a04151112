from __future__ import annotations

import pytest

from expert.engine import make_engine
from expert.rules.cases import read_cases, run_cases
from expert.rules.missing import missing_cases

RULES = """version: 1
thresholds: {{dark_dn: {{value: 6.0, unit: dn, because: a test}}}}
findings: {{dark: it is dark, odd: it is odd}}
rules:
  - id: COR001
    name: dark
    stage: correction
    when: {when}
    then: [{{derive: dark}}]
    because: It is needed for a test.
    references: [none]
"""


@pytest.fixture
def engine(words):
    return make_engine("compiled", words)


@pytest.fixture
def proposed(load, words, engine, tmp_path):
    def propose(when, *cases):
        """Return the loaded rules, the directory of its cases and what is proposed for them."""
        folder = tmp_path / "cases"
        folder.mkdir(exist_ok=True)
        (folder / "COR001.yaml").write_text("\n".join(cases) + "\n")
        loaded = load(RULES.format(when=when))
        files, problems = read_cases(loaded.merged, words, folder)
        assert problems == []
        return loaded, folder, missing_cases(loaded, engine, words, files)

    return propose


FIRING = (
    "- {name: fires, facts: [{fact: brightness, offset_dn: -9.0, sigma_dn: 1.0, clipped_fraction: 0.2}], fires: true}"
)


@pytest.mark.parametrize(
    ("when", "values", "fires"),
    [
        ("[{fact: brightness, field: offset_dn, op: abs_ge, value: {threshold: dark_dn}}]", [-6.0], [True]),
        ("[{fact: brightness, field: offset_dn, op: lt, value: -2.0}]", [-2.0], [False]),
        ("[{fact: brightness, field: offset_dn, op: between, value: [-10, 4]}]", [-10.0, 4.0], [True, True]),
        ("[{not: {fact: brightness, field: offset_dn, op: gt, value: 1.5}}, {fact: brightness}]", [1.5], [True]),
        (
            "[{fact: brightness, field: offset_dn, op: le, value: {mul: [{field: brightness.sigma_dn}, 3]}}]",
            [3.0],
            [True],
        ),
    ],
)
def test_the_value_is_moved_to_each_limit_and_the_verdict_is_that_of_the_rule(proposed, when, values, fires):
    _, _, (cases, impossible) = proposed(when, FIRING)
    assert [next(iter(case.facts)).get("offset_dn") for case in cases] == values
    assert [case.fires for case in cases] == fires
    assert impossible == []


def test_proposed_cases_pass_once_they_are_added_and_nothing_is_missing_then(proposed, words, engine):
    when = (
        "[{fact: brightness, field: offset_dn, op: abs_ge, value: 6.0}, {finding: odd, at_least: major}, "
        "{fact: brightness, field: clipped_fraction, op: between, value: [0.1, 0.5]}]"
    )
    firing = FIRING.replace(", fires: true", ", findings: [{finding: odd, severity: major}], fires: true")
    loaded, folder, (cases, _) = proposed(when, firing)
    assert len(cases) == 3
    loaded, folder, again = proposed(when, firing, *map(str, cases))
    assert again == ([], [])
    assert all(result.passed for result in run_cases(loaded, engine, words, None, folder))


def test_a_limit_that_no_case_can_reach_is_said(proposed):
    when = "[{fact: brightness, field: offset_dn, op: lt, value: 5.0}]"
    quiet = "- {name: quiet, facts: [{fact: brightness, offset_dn: 9.0}], fires: false}"
    _, _, found = proposed(when, quiet)
    assert found == ([], ["COR001, when.1: no firing case can be moved to the limit"])


def test_a_proposed_case_that_fires_says_what_to_expect(proposed):
    _, _, (found, _) = proposed("[{fact: brightness, field: offset_dn, op: le, value: -6}]", FIRING)
    assert [(case.fires, case.expect) for case in found] == [(True, {"derive": "dark", "severity": "minor"})]
    assert "  expect: {derive: dark, severity: minor}\n" in str(found[0])
