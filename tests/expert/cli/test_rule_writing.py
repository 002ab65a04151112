from __future__ import annotations

import pytest
from typer.testing import CliRunner

from expert.cli.rules import app
from expert.facts import vocabulary
from expert.rules.load import load_rules
from modules.catalog import operators, probes


def invoke(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.mark.parametrize("stage", ["measurement", "correction", "matching", "reconstruction"])
def test_a_new_rule_lacks_only_its_rationale_and_its_references(tmp_path, stage):
    file, cases = tmp_path / "rig.yaml", tmp_path / "cases"
    result = invoke("new", stage, "dust-on-lens", "--write", file, "--cases", cases)
    assert result.exit_code == 0, result.output
    identifier = result.output.split()[0]
    checked = invoke("check", file, "--cases", cases)
    assert checked.exit_code == 1
    complaints = checked.output.splitlines()
    assert [line.split(": ")[1:3] for line in complaints] == [
        ["missing-rationale", f"rule {identifier}"],
        ["missing-reference", f"rule {identifier}"],
    ]
    text = file.read_text().replace('because: ""', "because: dust scatters light").replace("[]", "[a test]")
    file.write_text(text)
    tested = invoke("test", identifier, "--rules", file, "--cases", cases)
    assert tested.output == "2 cases, 0 failed\n"
    assert invoke("fmt", "--check", file, cases / f"{identifier}.yaml").exit_code == 0


def test_a_second_rule_gets_the_next_id(tmp_path):
    file = tmp_path / "rig.yaml"
    first = invoke("new", "matching", "dust-on-lens", "--write", file).output.split()[0]
    file.write_text(file.read_text().replace('because: ""', "because: dust scatters light").replace("[]", "[a test]"))
    assert invoke("new", "matching", "dust-on-lens", "--rules", file).exit_code == 2
    second = invoke("new", "matching", "rain-on-lens", "--write", file).output.split()[0]
    assert int(second[3:]) == int(first[3:]) + 1


def test_a_new_rule_is_printed_ready_to_paste(tmp_path):
    result = invoke("new", "correction", "dust-on-lens")
    rule, _, cases = result.output.partition("\n# knowledge/cases/")
    assert rule.startswith("  - id: COR")
    assert "fires: true" in cases


def test_wrong_names_and_stages_are_wrong_usage():
    assert "small letters" in invoke("new", "correction", "Dust on lens").output
    assert invoke("new", "corection", "dust-on-lens").exit_code == 2


def test_fmt_says_what_it_would_do_and_does_it_once(tmp_path):
    file = tmp_path / "rig.yaml"
    file.write_text("version:   1 # mine\nrules:\n- id: COR901\n")
    checked = invoke("fmt", file, "--check")
    assert (checked.exit_code, checked.output) == (1, f"{file} is not laid out; run terrex rules fmt {file}\n")
    assert invoke("fmt", file).output == f"laid out {file}\n"
    assert file.read_text() == "version: 1   # mine\nrules:\n  - id: COR901\n"
    assert (invoke("fmt", file).output, invoke("fmt", file, "--check").exit_code) == ("", 0)


def test_fmt_leaves_a_broken_file_alone_and_goes_on(tmp_path):
    broken, good = tmp_path / "broken.yaml", tmp_path / "good.yaml"
    broken.write_text("a: [\n")
    good.write_text("a:   1\n")
    result = invoke("fmt", broken, good, tmp_path / "none.yaml")
    assert result.exit_code == 2
    assert f"{broken}:2:1: yaml-syntax" in result.output
    assert (broken.read_text(), good.read_text()) == ("a: [\n", "a: 1\n")


def test_a_layered_file_means_the_same_after_fmt(tmp_path):
    file = tmp_path / "rig.yaml"
    file.write_text(
        "version: 1\nthresholds:\n    noise_dn: {value: 7, unit: dn,\n       because: our camera is noisy}\n"
        "disable: [COR016]\n"
    )
    known = (vocabulary(probes().values()), operators(), probes())
    before = load_rules([file], *known).digest
    assert invoke("fmt", file).output
    assert load_rules([file], *known).digest == before
