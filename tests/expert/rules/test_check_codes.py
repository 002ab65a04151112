"""Every code of a check has one file, an example that is refused in the golden words beside it, and a sound one."""

from __future__ import annotations

import ast
from importlib import resources
from pathlib import Path

import pytest

import expert.rules
from expert.facts import vocabulary
from expert.rules.check import check_rules
from expert.rules.checks import codes
from expert.rules.checks.catalog import CHECKS
from expert.rules.checks.examples import EXAMPLES, OVER_SHIPPED
from expert.rules.load import load_rules
from expert.rules.problem import RuleFileError
from expert.rules.reader import MAX_BYTES, read_document
from modules.catalog import operators, probes

WITHOUT_FILE = {"unreadable", "too-large"}  # an example of these is no file, or 4 MB of one
OF_OTHER_TOOLS = {"not-formatted", "cannot-append"}  # of `fmt` and `new`, which check nothing
GOLDEN = Path(__file__).parent / "codes"


def problems_of(code: str, kind: str, monkeypatch) -> list:
    monkeypatch.chdir(EXAMPLES)
    known = (vocabulary(probes().values()), operators(), probes())
    asked = code == "missing-case"
    over = code in OVER_SHIPPED
    return check_rules([Path(f"{code}.{kind}.yaml")], *known, shipped=over, cases=Path("cases"), with_cases=asked)


@pytest.mark.parametrize("code", sorted(set(CHECKS) - WITHOUT_FILE))
def test_the_bad_example_of_a_code_is_reported_in_these_words_and_the_good_one_is_clean(code, monkeypatch):
    found = problems_of(code, "bad", monkeypatch)
    assert [problem.code for problem in found] == [code]
    assert f"{found[0]}\n" == (GOLDEN / f"{code}.txt").read_text(encoding="utf-8")
    assert problems_of(code, "good", monkeypatch) == []


def test_the_codes_without_an_example_are_reported_too(tmp_path):
    with pytest.raises(RuleFileError, match="too-large: the file has 4000001 bytes, more than 4000000; split it"):
        read_document("x.yaml", b"#" * (MAX_BYTES + 1))
    with pytest.raises(
        RuleFileError, match="unreadable: cannot read the file: No such file or directory; check the path"
    ):
        load_rules([tmp_path / "none.yaml"], {}, {}, {}, shipped=False)


def test_every_code_has_a_file_of_its_name():
    files = {item.name for item in resources.files(codes).iterdir() if item.name.endswith(".py")}
    assert files - {"__init__.py"} == {code.replace("-", "_") + ".py" for code in CHECKS}
    assert all(check.code == code for code, check in CHECKS.items())


def test_no_example_is_left_of_a_code_that_is_gone():
    names = {path.name.rsplit(".", 2)[0] for path in EXAMPLES.glob("*.yaml")}
    assert names == set(CHECKS) - WITHOUT_FILE == {path.stem for path in GOLDEN.iterdir()}


def test_every_code_in_the_source_is_in_the_catalog():
    written = set()
    for path in Path(expert.rules.__path__[0]).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", "")) in (
                "problem", "Problem", "complain",
            ):  # fmt: skip
                texts = [item.value for item in node.args if isinstance(item, ast.Constant)]
                written |= {
                    text
                    for text in texts
                    if isinstance(text, str) and text.islower() and "-" in text and " " not in text
                }
    assert len(written) > 30
    assert written - OF_OTHER_TOOLS <= set(CHECKS)


def test_every_check_says_what_why_and_what_to_do():
    for check in CHECKS.values():
        assert check.level in ("error", "warning", "note")
        assert all(text.endswith(".") and len(text) > 10 for text in (check.reports, check.why, check.remedy))
