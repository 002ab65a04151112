from __future__ import annotations

import json

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
    then: [{derive: slow}]
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


def test_check_writes_json(rules):
    rules.write_text(RULES.replace("derive: slow", "derive: slo"))
    result = invoke("check", rules, "--alone", "--json")
    assert [item["code"] for item in json.loads(result.output)] == ["undeclared-finding"]


def test_check_leaves_with_2_when_a_file_cannot_be_read(tmp_path):
    assert invoke("check", tmp_path / "none.yaml", "--alone").exit_code == 2


def test_the_schema_is_json():
    schema = json.loads(invoke("schema").output)
    assert schema["title"] == "terrex rule file"
    assert "Comparison" in schema["$defs"]
