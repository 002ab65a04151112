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


def test_a_case_that_names_no_fact_is_reported_and_not_read(words, operators, probes, good_text, tmp_path):
    path = tmp_path / "rules.yaml"
    path.write_text(good_text)
    (tmp_path / "cases").mkdir()
    for case in CASES.glob("*.yaml"):
        (tmp_path / "cases" / case.name).write_text(
            case.read_text() + "- {name: bare, fires: false, facts: [{field: 1}]}\n"
        )
    found = check_rules([path], words, operators, probes, shipped=False, cases=tmp_path / "cases")
    assert {Path(problem.file).parent.name for problem in found} == {"cases"}
    assert set(codes(found)) == {"unknown-fact"}


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


def test_only_the_measurement_leaves_a_probe_out(check, good_text):
    rule = RULE.format(
        id="COR003", when="{fact: brightness, field: offset_dn, op: gt, value: 1}", then="{exclude: measurement.sides}"
    )
    (problem,) = [item for item in check(good_text + rule) if item.code == "wrong-stage"]
    assert problem.message == (
        "rule COR003, action 1: probe 'measurement.sides' runs before this stage and cannot be left out in it"
    )


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
        return codes(check(good_text + one + other.replace("under-test", "also-under-test"), with_cases=False))

    condition = "{{fact: brightness, field: offset_dn, op: {}, value: 3}}"
    assert two(condition.format("gt"), condition.format("ge")) == ["tie"]
    assert two(condition.format("gt"), condition.format("le")) == []
    assert two(condition.format("ge"), condition.format("le")) == ["tie"]


def test_a_formula_that_may_leave_its_range_is_reported(check, good_text):
    pixels = "{mul: [{field: brightness.sigma_dn}, {value: 1, unit: px/dn}]}"

    def with_radius(formula):
        then = f"{{choose: correction.gain, with: {{radius_px: {formula}}}}}"
        return check(good_text + RULE.format(id="COR003", when="{fact: brightness}", then=then), with_cases=False)

    assert sorted(codes(with_radius(f"{{add: [{pixels}, 1]}}"))) == ["may-exceed", "not-whole"]
    assert with_radius(f"{{round: {{clamp: [{pixels}, 1, 20]}}}}") == []


@pytest.mark.parametrize(
    ("formula", "message"),
    [
        ("{field: brightness.sigma_dn}", "'radius_px' of 'correction.gain' is in px, but the value is in dn"),
        ("{add: [{field: brightness.sigma_dn}, {value: 1, unit: px}]}", "the formula mixes dn and px"),
        ("{max: [{threshold: large_offset}, {field: brightness.clipped_fraction}]}", "the formula mixes dn and 1"),
        ("{mul: [{field: brightness.sigma_dn}, {field: brightness.sigma_dn}]}", "but the value is in dn2"),
        ("{div: [{field: brightness.sigma_dn}, {value: 2, unit: dn/px}]}", ""),
        ("{mul: [2, {value: 3, unit: px}]}", ""),
        ("{value: 3, unit: pixel-ish}", "'pixel-ish' is not a unit"),
    ],
)
def test_units_are_followed_through_formulas(check, good_text, formula, message):
    then = f"{{choose: correction.gain, with: {{radius_px: {{round: {{clamp: [{formula}, 1, 20]}}}}}}}}"
    problems = check(good_text + RULE.format(id="COR003", when="{fact: brightness}", then=then), with_cases=False)
    assert codes(problems) == (["wrong-unit"] if message else [])
    assert not message or message in problems[0].message


def test_units_are_followed_through_the_formulas_of_conditions(check, good_text):
    when = (
        "{fact: brightness, as: b, field: offset_dn, op: gt, value: {mul: [{field: b.sigma_dn}, {value: 2, unit: px}]}}"
    )
    text = RULE.format(id="COR003", when=when, then="{measure: measurement.sides}")
    (problem,) = check(good_text + text, with_cases=False)
    assert problem.message.endswith("'offset_dn' is in dn, what it is compared with in dn px")


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


def test_a_faulty_part_hides_no_fault_elsewhere_in_its_rule_and_moves_none(check):
    text = "version: 1\nfindings: {f: text}\nrules:\n" + RULE.format(
        id="COR001",
        when="{fact: brightness, field: offset_dn, op: more, value: 1}, {fact: brightnes}, {finding: g}",
        then="{derive: f, severity: bad}, {exclude: correction.non}, "
        "{set: correction.match_histograms, parameter: nope, to: {field: b.offset_dn}}",
    )
    found = check(text.replace("stage: correction", "stage: corection").replace("COR001", "own1"))
    assert set(codes(found)) == {
        *(
            "wrong-pattern",
            "unknown-value",
            "unknown-fact",
            "undeclared-finding",
            "unknown-operator",
            "unknown-parameter",
        )
    }
    lines = text.splitlines()
    places = {"unknown-fact": "brightnes}", "undeclared-finding": "g}", "unknown-operator": "correction.non}"}
    for code, word in places.items():
        (problem,) = [item for item in found if item.code == code]
        assert lines[problem.line - 1][problem.column - 1 :].startswith(word)
