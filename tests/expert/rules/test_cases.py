from __future__ import annotations

from pathlib import Path

import pytest

from expert.engine import make_engine
from expert.rules.cases import read_cases, run_cases
from expert.rules.coverage import coverage
from expert.rules.problem import RuleFileError

CASES = Path(__file__).parent / "cases"


@pytest.fixture
def run(load, good_text, words):
    def run_in(directory, text=good_text):
        loaded = load(text)
        return loaded, run_cases(loaded, make_engine("compiled", words), words, directory=directory)

    return run_in


def test_cases_of_a_sound_rule_pass(run):
    _, results = run(CASES)
    assert len(results) == 7
    assert all(result.passed for result in results), [str(result) for result in results]


def test_a_case_that_should_fire_names_the_first_failing_condition_and_its_margin(run, tmp_path):
    (tmp_path / "COR001.yaml").write_text(
        "- name: too small\n  facts: [{fact: brightness, offset_dn: -5.5}]\n  fires: true\n"
    )
    _, (result,) = run(tmp_path)
    assert result.message == (
        "expected that it fires, but it stays quiet; the offset_dn of brightness is at least the threshold "
        "large_offset (6 dn) in magnitude: measured -5.5, limit 6.0, margin 0.5"
    )


def test_a_case_that_should_stay_quiet_names_the_nearest_limit(run, tmp_path):
    (tmp_path / "COR001.yaml").write_text(
        "- name: large\n  facts: [{fact: brightness, offset_dn: 7}]\n  fires: false\n"
    )
    _, (result,) = run(tmp_path)
    assert result.message.startswith("expected that it stays quiet, but it fires")
    assert result.message.endswith("measured 7, limit 6.0, margin 1")


def test_an_expected_value_that_differs_is_shown_with_what_came_out(run, tmp_path):
    text = (CASES / "COR002.yaml").read_text().replace("strength: 0.2", "strength: 0.3")
    (tmp_path / "COR002.yaml").write_text(text)
    _, results = run(tmp_path)
    assert "strength': 0.3" in results[0].message
    assert "strength': 0.2" in results[0].message


@pytest.fixture
def covered(run, words):
    def covered_in(directory, text=None):
        loaded, results = run(directory) if text is None else run(directory, text)
        files, _ = read_cases(loaded.merged, words, directory)
        return coverage(loaded, make_engine("compiled", words), results, files, words)

    return covered_in


def test_coverage_names_the_rules_without_a_kind_of_case(covered, tmp_path):
    assert covered(CASES).complete
    (tmp_path / "COR002.yaml").write_text("- {name: nothing, facts: [], fires: false}\n")
    found = covered(tmp_path)
    assert found.without_firing == ("COR001", "COR002")
    assert found.without_quiet == ("COR001",)
    assert found.without_boundary == ("COR001", "COR002")


def test_coverage_names_conditions_and_actions_that_no_case_exercises(covered, tmp_path):
    for name in ("COR001", "COR002"):
        (tmp_path / f"{name}.yaml").write_text((CASES / f"{name}.yaml").read_text())
    (tmp_path / "COR002.yaml").write_text(
        "- name: fires\n  facts: [{fact: brightness, offset_dn: 20, clipped_fraction: 0.01}]\n"
        "  findings: [{finding: exposure-differs, severity: major}]\n  fires: true\n"
        "- {name: no finding, facts: [{fact: brightness, offset_dn: 20, clipped_fraction: 0.05}], fires: false}\n"
    )
    found = covered(tmp_path)
    assert found.never_true == ("COR002: the clipped_fraction of brightness is above 0.05",)
    assert found.never_false == (
        "COR002: there is a fact brightness",
        "COR002: it is not so that the clipped_fraction of brightness is above 0.05",
    )
    (action,) = found.never_expected
    assert action.startswith("COR002: choose correction.match_histograms with channels gray, strength clamp(")
    lines = list(found.lines())
    assert "conditions that no case makes true: 1 of 5" in lines
    assert "actions that no case expects: 1 of 2" in lines
    assert not found.complete


def test_faulty_cases_are_reported_with_their_place(run, tmp_path):
    (tmp_path / "COR001.yaml").write_text(
        "- name: typo\n  facts:\n    - {fact: brightness, ofset_dn: 7}\n    - {fact: brightness, offset_dn: 700}\n"
        "  fires: false\n- {name: no verdict}\n"
    )
    (tmp_path / "COR777.yaml").write_text("[]\n")
    with pytest.raises(RuleFileError) as caught:
        run(tmp_path)
    assert [(item.line, item.code) for item in caught.value.problems] == [
        (3, "unknown-field"), (4, "out-of-range"), (6, "missing-key"), (1, "unknown-rule"),
    ]  # fmt: skip
