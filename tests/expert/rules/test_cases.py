from __future__ import annotations

from pathlib import Path

import pytest

from expert.engine import make_engine
from expert.rules.cases import coverage, run_cases
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
    assert len(results) == 5
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


def test_coverage_names_the_rules_without_a_kind_of_case(run, words, tmp_path):
    loaded, results = run(CASES)
    assert coverage(loaded, results, words).complete
    (tmp_path / "COR002.yaml").write_text("- {name: nothing, facts: [], fires: false}\n")
    loaded, results = run(tmp_path)
    found = coverage(loaded, results, words)
    assert found.without_firing == ("COR001", "COR002")
    assert found.without_quiet == ("COR001",)
    assert found.without_boundary == ("COR001", "COR002")


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
