"""Whatever a file holds, it is accepted or refused with a position; `make fuzz` tries many more, drawn anew."""

from __future__ import annotations

import os
import random
import resource
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from expert.rules.load import load_rules
from expert.rules.problem import RuleFileError
from expert.rules.reader import MAX_BYTES, MAX_NODES, read_document
from expert.rules.style import format_rules

MANY = os.environ.get("TERREX_FUZZ")
FUZZ = settings(
    max_examples=int(MANY or 60),
    derandomize=MANY is None,
    database=None,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
CPU_S, MEMORY_BYTES = 60, 2_000_000_000  # for the largest file that is read at all, several times what it needs


def problems_of(call):
    """Return the problems with which a call refuses its input; any other exception is a failure."""
    try:
        call()
    except RuleFileError as error:
        return error.problems
    return None


def assert_sound(problems, raw: bytes) -> None:
    """Every problem has a place in the file and says something."""
    if problems is None:
        return
    assert problems
    last = raw.count(b"\n") + raw.count(b"\r") + raw.count("\u2028".encode()) + raw.count("\x85".encode()) + 2
    last += raw.count("\u2029".encode())
    for item in problems:
        assert 1 <= item.line <= last
        assert 1 <= item.column <= len(raw) + 2
        assert item.code
        assert item.message.isprintable(), item.message


KEYS = (
    "version",
    "thresholds",
    "findings",
    "slots",
    "rules",
    "disable",
    "id",
    "name",
    "stage",
    "priority",
    "when",
    "then",
    "because",
    "references",
    "fact",
    "as",
    "field",
    "op",
    "value",
    "unit",
    "finding",
    "at_least",
    "not",
    "any_of",
    "exists",
    "for_all",
    "where",
    "derive",
    "measure",
    "choose",
    "exclude",
    "set",
    "assess",
    "adjust",
    "repair",
    "severity",
    "slot",
    "with",
    "score",
    "parameter",
    "to",
    "by",
    "times",
    "at_most",
    "threshold",
    "add",
    "sub",
    "mul",
    "div",
    "min",
    "max",
    "clamp",
    "round",
    "floor",
    "ceil",
    "default",
)
WORDS = (
    "brightness",
    "offset_dn",
    "side",
    "left",
    "correction",
    "matching",
    "correction.gain",
    "radiometry",
    "COR001",
    "COR002",
    "brightness.offset_dn",
    "large_offset",
    "exposure-differs",
    "gt",
    "between",
    "in",
    "present",
    "none",
    "dn",
    "px/0",
    "major",
)
SCALAR = st.one_of(
    st.sampled_from(WORDS),
    st.integers(-(10**20), 10**20),
    st.floats(allow_nan=False),
    st.booleans(),
    st.none(),
    st.text(max_size=8),
)
TREE = st.recursive(
    SCALAR,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.dictionaries(st.one_of(st.sampled_from(KEYS), st.text(max_size=3)), inner, max_size=5),
    ),
    max_leaves=25,
)


def tried(raw: bytes, words, operators, probes, folder) -> None:
    path = folder / "fuzz.yaml"
    path.write_bytes(raw)
    assert_sound(problems_of(lambda: load_rules([path], words, operators, probes, shipped=False)), raw)


@FUZZ
@given(raw=st.binary(max_size=300))
def test_any_bytes(raw):
    assert_sound(problems_of(lambda: read_document("x.yaml", raw)), raw)


@FUZZ
@given(
    text=st.text(
        alphabet=st.sampled_from("ab: -[]{}'\"#&*!|>%@`\t\n\r,?~0.5e\u2028\u0085\ufeff\u200f\u0301é\U0001f600"),
        max_size=120,
    )
)
def test_any_text_of_what_yaml_finds_special(text):
    raw = text.encode()
    assert_sound(problems_of(lambda: read_document("x.yaml", raw)), raw)
    assert_sound(problems_of(lambda: format_rules("x.yaml", raw)), raw)


@FUZZ
@given(data=st.data())
def test_a_rule_file_with_pieces_changed(data, good_text, words, operators, probes, tmp_path_factory):
    text = good_text
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(text)))
        length = data.draw(st.integers(0, 12))
        piece = data.draw(
            st.sampled_from(
                [
                    "",
                    "\t",
                    "- ",
                    ": ",
                    "{",
                    "}",
                    "[]",
                    "null",
                    "not: ",
                    "*a",
                    "&a ",
                    "'",
                    "1.5",
                    "\n",
                    "\r",
                    "\ufeff",
                    "\u2028",
                    "!!x ",
                    "1e400",
                ]
            )
        )
        text = text[:start] + piece + text[start + length :]
    tried(text.encode(), words, operators, probes, tmp_path_factory.getbasetemp())


@FUZZ
@given(tree=TREE, place=st.sampled_from(["rules", "when", "then", "value", "with", "slots", "thresholds", "top"]))
def test_any_tree_in_the_words_of_the_language(tree, place, good_text, words, operators, probes, tmp_path_factory):
    data = yaml.safe_load(good_text)
    rule = data["rules"][0]
    if place == "top":
        data = tree
    elif place in ("rules", "slots", "thresholds"):
        data[place] = tree
    elif place in ("when", "then"):
        rule[place] = [tree]
    elif place == "value":
        rule["when"][0]["value"] = tree
    else:
        rule["then"] = [{"choose": "correction.gain", "with": {"strength": tree}}]
    raw = yaml.safe_dump(data, allow_unicode=True, sort_keys=False).encode("utf-8", "surrogatepass")
    tried(raw, words, operators, probes, tmp_path_factory.getbasetemp())


def nested(kind: str, depth: int) -> str:
    """Return a condition that is nested deep in one way."""
    if kind == "not":
        return "{not: " * depth + "{finding: exposure-differs}" + "}" * depth
    if kind == "any_of":
        return "{any_of: [" * depth + "{finding: exposure-differs}" + "]}" * depth
    formula = "{round: " * depth + "1" + "}" * depth
    return f"{{fact: brightness, field: offset_dn, op: gt, value: {formula}}}"


@pytest.mark.parametrize("kind", ["not", "any_of", "round"])
@pytest.mark.parametrize("depth", [1, 10, 17, 30, 39, 40, 1000, 50_000])
def test_deep_nesting(kind, depth, good_text, words, operators, probes, tmp_path):
    text = good_text.replace("- {finding: exposure-differs, at_least: major}", f"- {nested(kind, depth)}")
    tried(text.encode(), words, operators, probes, tmp_path)


def large(kind: str, size: int) -> bytes:
    """Return a large file of one kind."""
    source = random.Random(1)
    if kind == "random":
        return source.randbytes(size)
    unit = {
        "blanks": b" ",
        "lines": b"\n",
        "returns": b"\r",
        "tabs": b"\t",
        "brackets": b"[",
        "braces": b"{",
        "dashes": b"- ",
        "items": b"- a\n",
        "flow": b"[],",
        "quote": b"'",
        "comments": b"#\n",
        "letters": b"a",
        "wide": "\U0001f600".encode(),
        "bom": b"\xef\xbb\xbf",
        "keys": b"a: 1\n",
        "anchors": b"- &a [*a]\n",
        "tags": b"- !!x y\n",
        "folded": b"> ",
        "question": b"? ",
    }[kind]
    head = b"rules: [" if kind == "flow" else b""
    return head + unit * ((size - len(head)) // len(unit))


KINDS = (
    "random",
    "blanks",
    "lines",
    "returns",
    "tabs",
    "brackets",
    "braces",
    "dashes",
    "items",
    "flow",
    "quote",
    "comments",
    "letters",
    "wide",
    "bom",
    "keys",
    "anchors",
    "tags",
    "folded",
    "question",
)


@pytest.mark.parametrize("kind", KINDS)
def test_ten_megabytes_are_refused_before_they_are_parsed(kind, tmp_path):
    path = tmp_path / "large.yaml"
    path.write_bytes(large(kind, 10_000_000))
    (problem,) = problems_of(lambda: load_rules([path], {}, {}, {}, shipped=False))
    assert problem.code == "too-large"


CHILD = """
import sys
from pathlib import Path
from expert.rules.load import load_rules
from expert.rules.problem import RuleFileError
try:
    load_rules([Path(sys.argv[1])], {}, {}, {}, shipped=False)
except RuleFileError as error:
    print(len(error.problems), max(item.line for item in error.problems))
"""


def limit() -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))


@pytest.mark.skipif(sys.platform == "win32", reason="needs limits of the operating system")
@pytest.mark.parametrize("kind", KINDS if MANY else ("items", "random"))
def test_the_largest_file_that_is_read_keeps_within_time_and_memory(kind, tmp_path):
    path = tmp_path / "large.yaml"
    path.write_bytes(large(kind, MAX_BYTES))
    child = subprocess.run(
        [sys.executable, "-c", CHILD, str(path)],
        preexec_fn=limit,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "OPENBLAS_NUM_THREADS": "1"},
    )
    assert child.returncode == 0, child.stderr[-2000:]


def test_a_file_of_more_values_than_any_rule_file_has_is_refused_where_it_goes_too_far():
    (problem,) = problems_of(lambda: read_document("x.yaml", b"- a\n" * (MAX_NODES + 1)))
    assert (problem.code, problem.line) == ("too-large", MAX_NODES - 1)


def test_an_alias_bomb_is_refused_at_its_first_alias():
    lines = ["a0: &a0 [x, x]", *(f"a{n}: &a{n} [*a{n - 1}, *a{n - 1}]" for n in range(1, 40))]
    problems = problems_of(lambda: read_document("x.yaml", "\n".join(lines).encode()))
    assert {item.code for item in problems} == {"alias"}
    assert problems[0].line == 2


@pytest.mark.parametrize("name", sorted(path.name for path in (Path(__file__).parent / "bad").glob("*.yaml")))
def test_every_bad_file_is_refused_alike_with_windows_line_ends_and_a_mark(name, words, operators, probes, tmp_path):
    raw = (Path(__file__).parent / "bad" / name).read_bytes()
    found = []
    for text in (raw, b"\xef\xbb\xbf" + raw.replace(b"\n", b"\r\n")):
        path = tmp_path / name
        path.write_bytes(text)
        problems = problems_of(lambda path=path: load_rules([path], words, operators, probes, shipped=False))
        found.append([(item.line, item.column, item.code) for item in problems])
    assert found[0] == found[1]
