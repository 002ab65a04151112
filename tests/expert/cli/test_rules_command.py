from __future__ import annotations

import json
import re

import pytest
from typer.testing import CliRunner

from expert.cli.rules import app

RULES = """version: 1
findings: {slow: the pair takes long}
slots:
  correction: [{slot: radiometry, default: none, because: nothing}]
rules:
  - id: COR901
    name: under-test
    stage: correction
    when: [{fact: task, field: profile, op: eq, value: fast}]
    then: [{derive: slow, severity: critical}]
    because: A reason that is long enough.
    references: [none]
"""


@pytest.fixture
def rules(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(RULES)
    return path


def invoke(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_check_leaves_with_0_when_a_file_is_clean(rules):
    result = invoke("check", rules, "--alone", "--no-cases")
    assert (result.exit_code, result.output) == (0, "no problems\n")


def test_check_leaves_with_1_and_names_the_place_of_a_problem(rules):
    rules.write_text(RULES.replace("value: fast", "value: fasst"))
    result = invoke("check", rules, "--alone")
    assert result.exit_code == 1
    assert f"{rules}:9:56: out-of-range: rule COR901, condition 1" in result.output


def test_check_leaves_with_0_though_the_cases_of_own_rules_lie_nowhere_that_it_knows(rules):
    path = rules.parent / "rig.yaml"
    path.write_text(
        "version: 1\nrules:\n  - {id: RIG001, name: wide, stage: measurement, when: [{fact: task}], "
        "then: [{measure: measurement.disparity_range}], because: We want it., references: [rig]}\n"
    )
    result = invoke("check", str(path))
    assert result.exit_code == 0
    assert "note: missing-case: rule RIG001 has no case" in result.output
    assert "RIG001.yaml and give --cases FOLDER\nno problems\n" in result.output
    assert invoke("check", str(path), "--cases", str(rules.parent)).exit_code == 1


def test_a_threshold_that_takes_the_place_of_a_shipped_one_is_noted(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text("version: 1\nthresholds:\n  exposure_dn: {value: 8.5, unit: dn, because: our lamps flicker}\n")
    result = invoke("check", path)
    assert "note: override: threshold exposure_dn is 8.5 dn, in the place of 6 dn in knowledge/rules.yaml" in (
        result.output
    )
    assert result.exit_code == 0


def test_check_writes_json(rules):
    rules.write_text(RULES.replace("derive: slow", "derive: slo"))
    result = invoke("check", rules, "--alone", "--json")
    assert [item["code"] for item in json.loads(result.output)] == ["undeclared-finding"]


def test_check_writes_the_format_that_is_asked_for(rules):
    rules.write_text(RULES.replace("derive: slow", "derive: slo"))
    result = invoke("check", rules, "--alone", "--format", "json")
    assert [item["code"] for item in json.loads(result.output)] == ["undeclared-finding"]
    result = invoke("check", rules, "--alone", "--format", "sarif")
    assert result.exit_code == 1
    assert [item["ruleId"] for item in json.loads(result.output)["runs"][0]["results"]] == ["undeclared-finding"]
    assert invoke("check", rules, "--format", "xml").exit_code == 2


def test_check_leaves_with_2_when_a_file_cannot_be_read(tmp_path):
    assert invoke("check", tmp_path / "none.yaml", "--alone").exit_code == 2


def test_the_schema_is_json():
    schema = json.loads(invoke("schema").output)
    assert schema["title"] == "terrex rule file"
    assert "Comparison" in schema["$defs"]


@pytest.fixture
def cases(tmp_path):
    folder = tmp_path / "cases"
    folder.mkdir()
    (folder / "COR901.yaml").write_text(
        "- {name: fast, facts: [{fact: task, profile: fast}], fires: true, expect: {derive: slow}}\n"
        "- {name: best, facts: [{fact: task, profile: best}], fires: false}\n"
    )
    return folder


def test_the_cases_of_a_layered_rule_run_on_both_engines(rules, cases):
    for engine in ("compiled", "experta"):
        result = invoke("test", "COR901", "--rules", rules, "--cases", cases, "--coverage", "--engine", engine)
        assert result.exit_code == 0, result.output
        assert result.output.startswith("2 cases, 0 failed\n")


def test_a_failing_case_leaves_with_1_and_says_why(rules, cases):
    (cases / "COR901.yaml").write_text("- {name: best, facts: [{fact: task, profile: best}], fires: true}\n")
    result = invoke("test", "--rules", rules, "--cases", cases)
    assert result.exit_code == 1
    assert "the profile of task is fast: measured best" in result.output


def test_explain_and_show_tell_where_a_rule_comes_from(rules):
    result = invoke("explain", "COR901", "--rules", rules)
    assert "when the profile of task is fast: note the critical finding slow" in result.output
    assert f"{rules}:6" in invoke("show", "--layers", "--rules", rules).output


def test_an_unknown_rule_or_engine_is_wrong_usage(rules, cases):
    assert invoke("explain", "COR999", "--rules", rules).exit_code == 2
    assert invoke("test", "--rules", rules, "--cases", cases, "--engine", "clips").exit_code == 2


def test_the_graph_shows_the_rules_of_a_stage_or_the_ones_asked_for(rules):
    assert "rule_COR901" in invoke("graph", "--rules", rules, "--stage", "correction").output
    assert "rule_COR901" not in invoke("graph", "--rules", rules, "--stage", "matching").output
    assert invoke("graph", "COR901", "--rules", rules).output == (
        "flowchart LR\n"
        '  fact_task[("task")]\n'
        '  finding_slow{{"slow"}}\n'
        "  subgraph correction\n"
        '    rule_COR901["COR901 under-test"]\n'
        "  end\n"
        '  fact_task -->|"profile"| rule_COR901\n'
        '  rule_COR901 -->|"derive"| finding_slow\n'
    )
    assert invoke("graph", "COR999", "--rules", rules).exit_code == 2


def test_the_cases_that_are_missing_are_printed_as_items_of_the_case_file(rules, cases):
    limited = "[{fact: task, field: time_budget_s, op: lt, value: 2.0}]"
    rules.write_text(RULES.replace("[{fact: task, field: profile, op: eq, value: fast}]", limited))
    (cases / "COR901.yaml").write_text("- {name: fast, facts: [{fact: task, time_budget_s: 1.0}], fires: true}\n")
    result = invoke("test", "COR901", "--rules", rules, "--cases", cases, "--missing")
    assert result.output == (
        "1 cases, 0 failed\n"
        "\n"
        "# for COR901.yaml; `fires` is what the rule does now, check that it should\n"
        "- name: time_budget_s of task at its limit 2 s\n"
        "  facts:\n"
        "    - {fact: task, time_budget_s: 2.0}\n"
        "  fires: false\n"
    )
    with (cases / "COR901.yaml").open("a") as stream:
        stream.write(result.output.partition("should\n")[2])
    result = invoke("test", "COR901", "--rules", rules, "--cases", cases, "--missing")
    assert result.output == "2 cases, 0 failed\nthe cases touch every limit\n"


def test_show_says_from_which_layer_each_rule_threshold_and_slot_comes(tmp_path):
    rig = tmp_path / "rig.yaml"
    rig.write_text(
        "thresholds:\n  exposure_dn: {value: 8, unit: dn, because: this rig}\n"
        "slots:\n  matching:\n    - {slot: refine, default: none, because: this rig}\ndisable: [COR010]\n"
    )
    lines = invoke("show", "--layers", "--rules", rig).output.splitlines()
    shipped = r"knowledge/rules\.yaml:\d+"
    assert any(re.fullmatch(rf"threshold  exposure_dn = 8 dn  {rig}:2, over {shipped}", line) for line in lines)
    assert any(re.fullmatch(rf"slot  matching\.refine = none  {rig}:5, over {shipped}", line) for line in lines)
    assert any(re.fullmatch(rf"MEA001 +measurement +range-not-given +{shipped}", line) for line in lines)
    assert f"COR010  disabled by {rig}:6" in lines
