from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

import knowledge
from expert.rules.problem import RuleFileError
from expert.rules.reader import read_document
from expert.rules.style import format_rules

FOLDER = Path(knowledge.__path__[0])

LOOSE = """# who keeps this file

version:   1
thresholds: {dark_dn:   {value: 6.0, unit: dn, because: "a test"}}  # one only
rules:
# the first part
- id: COR001
  name:  'dark'


  when:
    - {fact: brightness, field: mean_dn, op: lt, value: {add: [{threshold: dark_dn}, 1.50]}}
  then:
  - derive: dark   # nothing else
  because: >-
    A sentence that is
    folded.
"""
TIDY = """# who keeps this file

version: 1
thresholds: {dark_dn: {value: 6.0, unit: dn, because: "a test"}}    # one only
rules:
# the first part
  - id: COR001
    name: 'dark'

    when:
      - {fact: brightness, field: mean_dn, op: lt, value: {add: [{threshold: dark_dn}, 1.50]}}
    then:
      - derive: dark # nothing else
    because: >-
      A sentence that is
      folded.
"""


def test_indentation_and_blanks_become_alike_and_comments_stay():
    assert format_rules("rig.yaml", LOOSE.encode()) == TIDY


def test_laying_out_twice_is_laying_out_once():
    assert format_rules("rig.yaml", TIDY.encode()) == TIDY


def test_line_ends_and_a_byte_order_mark_do_not_matter():
    assert format_rules("rig.yaml", b"\xef\xbb\xbf" + LOOSE.replace("\n", "\r\n").encode()) == TIDY


@pytest.mark.parametrize(
    "path", [FOLDER / "rules.yaml", *sorted((FOLDER / "cases").glob("*.yaml"))], ids=lambda p: p.name
)
def test_the_shipped_files_are_laid_out(path):
    assert format_rules(path.name, path.read_bytes()) == path.read_text(encoding="utf-8")


def test_a_file_that_cannot_be_read_is_refused_with_its_problems():
    with pytest.raises(RuleFileError, match=r"rig.yaml:1:15: duplicate-key"):
        format_rules("rig.yaml", b"{version: 1,  version: 2}")


def test_a_file_of_comments_stays():
    assert format_rules("rig.yaml", b"\n# to come\n\n") == "# to come\n"
    assert format_rules("rig.yaml", b"") == ""


words = st.text("abc xyz-#:'é", min_size=1, max_size=12).map(str.strip).filter(bool)
scalars = st.one_of(words, st.booleans(), st.integers(-999, 999), st.floats(-1e3, 1e3).map(lambda x: round(x, 3)))
trees = st.recursive(
    scalars,
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.from_regex(r"[a-z_]{1,6}", fullmatch=True), inner, max_size=4)
    ),
    max_leaves=20,
)


@given(data=trees, flow=st.sampled_from([None, True, False]), indent=st.sampled_from([2, 3, 4]))
def test_what_a_file_says_never_changes(data, flow, indent):
    text = yaml.safe_dump(data, default_flow_style=flow, indent=indent, sort_keys=False, allow_unicode=True)
    try:
        said = read_document("rig.yaml", text.encode()).data
    except RuleFileError:
        return
    result = format_rules("rig.yaml", text.encode())
    assert read_document("rig.yaml", result.encode()).data == said
    assert format_rules("rig.yaml", result.encode()) == result


@given(st.lists(st.tuples(st.integers(0, 200), st.sampled_from(["# a note", "      # deep", "", "  "])), max_size=8))
def test_comments_and_blank_lines_anywhere_between_rules_survive(places):
    lines = (FOLDER / "rules.yaml").read_text(encoding="utf-8").split("\n")[:240]
    starts = [number for number, line in enumerate(lines) if line.startswith("  - id")]
    lines = lines[: starts[-1]]
    for start, text in sorted(((starts[place % (len(starts) - 1)], text) for place, text in places), reverse=True):
        lines.insert(start, text)
    text = "\n".join(lines) + "\n"
    result = format_rules("rig.yaml", text.encode())
    assert read_document("rig.yaml", result.encode()).data == read_document("rig.yaml", text.encode()).data
    assert re.findall("# .*", result) == re.findall("# .*", text)
    assert format_rules("rig.yaml", result.encode()) == result
