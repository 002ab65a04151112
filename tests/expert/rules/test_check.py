from __future__ import annotations

import json
from pathlib import Path

import pytest

from expert.rules.check import as_json, check_rules

CASES = Path(__file__).parent / "cases"
RULE = """  - id: {id}
    name: under-test
    stage: correction
    when: [{when}]
    then: [{then}]
    because: A reason that is long enough.
    references: [measured]
"""


@pytest.fixture
def check(words, operators, probes, tmp_path):
    def check_text(text, **options):
        path = tmp_path / "rules.yaml"
        path.write_text(text)
        return check_rules([path], words, operators, probes, shipped=False, cases=CASES, **options)

    return check_text


def codes(problems):
    return [problem.code for problem in problems]


def test_a_sound_file_with_all_cases_is_clean(check, good_text):
    assert check(good_text) == []


def test_a_rule_without_cases_is_reported_once(check, good_text):
    rule = RULE.format(
        id="COR003", when="{fact: brightness, field: offset_dn, op: gt, value: 1}", then="{measure: measurement.sides}"
    )
    (problem,) = check(good_text + rule)
    assert problem.code == "missing-case"
    assert problem.message == "rule COR003 has no case where it fires, none where it stays quiet, none at a threshold"


def test_unused_declarations_are_reported(check, good_text):
    text = good_text.replace("findings:\n", "findings:\n  never: said by none\n").replace(
        "thresholds:\n", "thresholds:\n  spare: {value: 1, because: none}\n"
    )
    assert sorted(codes(check(text))) == ["unused-finding", "unused-threshold"]


def test_a_finding_that_no_rule_derives_is_reported(check, good_text):
    assert "underived-finding" in codes(
        check(good_text.replace("{derive: exposure-differs, severity: major}", "{measure: measurement.sides}"))
    )


def test_a_slot_without_a_default_is_reported(check, good_text):
    assert codes(check(good_text.replace("radiometry, default: none", "radiometry"))) == ["slot-without-default"]


def test_a_tie_is_reported_unless_the_conditions_exclude_each_other(check, good_text):
    def two(first, second):
        one = RULE.format(id="COR003", when=first, then="{choose: correction.gain, score: 0.4}")
        other = RULE.format(id="COR004", when=second, then="{choose: correction.match_histograms, score: 0.4}")
        return codes(check(good_text + one + other, with_cases=False))

    condition = "{{fact: brightness, field: offset_dn, op: {}, value: 3}}"
    assert two(condition.format("gt"), condition.format("ge")) == ["tie"]
    assert two(condition.format("gt"), condition.format("le")) == []
    assert two(condition.format("ge"), condition.format("le")) == ["tie"]


def test_a_formula_that_may_leave_its_range_is_reported(check, good_text):
    rule = RULE.format(
        id="COR003", when="{fact: brightness}",
        then="{choose: correction.gain, with: {radius_px: {add: [{field: brightness.sigma_dn}, 1]}}}",
    )  # fmt: skip
    assert sorted(codes(check(good_text + rule, with_cases=False))) == ["may-exceed", "not-whole"]
    bounded = rule.replace(
        "{add: [{field: brightness.sigma_dn}, 1]}", "{round: {clamp: [{field: brightness.sigma_dn}, 1, 20]}}"
    )
    assert check(good_text + bounded, with_cases=False) == []


def test_a_comment_with_a_reason_silences_one_warning(check, good_text):
    def declared(comment):
        return codes(check(good_text.replace("findings:\n", f"findings:\n  never: said by none{comment}\n")))

    assert declared("  # terrex: ignore[unused-finding] another layer uses it") == []
    assert sorted(declared("  # terrex: ignore[unused-finding]")) == ["ignore-without-reason", "unused-finding"]
    assert sorted(declared("  # terrex: ignore[tie] why not")) == ["unused-finding", "unused-ignore"]


def test_errors_are_not_silenced_and_problems_are_plain_json(check, good_text):
    problems = check(good_text.replace("op: gt, value: 0.05}", "op: gt, value: 5}  # terrex: ignore[out-of-range] no"))
    assert codes(problems) == ["out-of-range"]
    assert json.loads(as_json(problems))[0]["line"] == problems[0].line
