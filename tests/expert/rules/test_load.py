from __future__ import annotations

import json

import pytest
from hypothesis import HealthCheck, given, seed, settings
from hypothesis import strategies as st

from expert.rules.load import load_rules
from expert.rules.problem import RuleFileError
from expert.rules.reader import MAX_BYTES, read_document


def problems_of(call):
    """Return the problems with which a call refuses its input; any other exception is a failure."""
    try:
        call()
    except RuleFileError as error:
        return error.problems
    return None


def sound(problems):
    return problems is None or (
        problems and all(item.line >= 1 and item.column >= 1 and item.message for item in problems)
    )


FUZZ = settings(max_examples=150, deadline=None, database=None, suppress_health_check=[HealthCheck.too_slow])


def test_a_sound_file_loads_with_the_line_of_every_rule(load, good_text):
    loaded = load(good_text)
    lines = good_text.splitlines()
    assert [rule.id for rule in loaded.base.rules] == ["COR001", "COR002"]
    assert all(lines[line - 1].strip() == f"- id: {name}" for name, (_, line) in loaded.positions.items())


def test_bom_and_windows_line_ends_change_nothing(load, good_text):
    changed = b"\xef\xbb\xbf" + good_text.replace("\n", "\r\n").encode()
    assert load(changed).digest == load(good_text).digest


def test_the_digest_ignores_the_order_of_rules_but_not_their_content(load, good_text):
    head, first, second = good_text.split("  - id:")
    swapped = f"{head}  - id:{second}  - id:{first}"
    assert load(swapped).digest == load(good_text).digest
    assert load(good_text.replace("score: 0.8", "score: 0.7")).digest != load(good_text).digest


def test_a_later_file_overrides_a_threshold_a_slot_and_a_rule_and_disables_another(load, good_text):
    layer = """
thresholds:
  large_offset: {value: 9, unit: dn, because: this rig}
slots:
  matching:
    - {slot: matcher, default: none, because: this rig}
disable: [COR002]
rules:
  - id: COR001
    name: offset-very-large
    stage: correction
    when: [{fact: brightness, field: offset_dn, op: gt, value: {threshold: large_offset}}]
    then: [{derive: exposure-differs}]
    because: This rig has a brighter camera.
    references: [rig]
"""
    loaded = load(good_text, layer)
    assert [rule.name for rule in loaded.base.rules] == ["offset-very-large"]
    assert loaded.base.thresholds["large_offset"].value == 9
    assert loaded.base.slots["matching"][0].default == "none"
    assert loaded.positions["COR001"][0].endswith("layer1.yaml")


def test_a_layer_that_breaks_a_reference_of_a_lower_one_is_refused_there(load, good_text):
    with pytest.raises(RuleFileError) as caught:
        load(good_text, "thresholds:\n  large_offset: {value: 6, unit: px, because: wrong unit}\n")
    assert [problem.code for problem in caught.value.problems] == ["wrong-unit"]
    assert caught.value.problems[0].file.endswith("layer0.yaml")


def test_problems_of_all_files_are_reported_together(load, good_text):
    with pytest.raises(RuleFileError) as caught:
        load("rules: [", good_text.replace("op: gt", "op: above"))
    assert {problem.code for problem in caught.value.problems} >= {"yaml-syntax", "unknown-value"}


def test_a_missing_file_is_unreadable(words, operators, probes, tmp_path):
    with pytest.raises(RuleFileError, match="cannot read the file"):
        load_rules([tmp_path / "none.yaml"], words, operators, probes, shipped=False)


@pytest.mark.parametrize(
    ("raw", "code"),
    [
        (b"\xff\xfe\x00a", "not-utf8"),
        (b"a: \x00", "yaml-syntax"),
        (b"a" * (MAX_BYTES + 1), "too-large"),
        (b"[" * 100_000, "too-deep"),
        (b"{" * 100_000, "too-deep"),
        (b"? {a: 1}\n: 2\n", "key-not-text"),
        (b"a: &x [*x]", "alias"),
        (b"a: 1e999", "not-finite"),
        (b"a: .nan", "ambiguous-value"),
        (b"a: 2014-01-01", "ambiguous-value"),
        (b'"\\0": 1', "key-not-text"),
    ],
)
def test_hostile_input_is_refused_by_name(raw, code):
    with pytest.raises(RuleFileError) as caught:
        read_document("x.yaml", raw)
    assert code in {problem.code for problem in caught.value.problems}


def test_numbers_are_read_as_people_read_them():
    data = read_document("x.yaml", b'[1, -2, 0.5, 1e3, .5, "1", true, null, text]').data
    assert data == [1, -2, 0.5, 1000.0, 0.5, "1", True, None, "text"]


@seed(1)
@FUZZ
@given(raw=st.binary(max_size=200))
def test_any_bytes_are_accepted_or_refused(raw):
    assert sound(problems_of(lambda: read_document("x.yaml", raw)))


@seed(2)
@FUZZ
@given(data=st.data())
def test_a_mutated_rule_file_is_accepted_or_refused(data, good_text, words, operators, probes, tmp_path_factory):
    text = good_text
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(text)))
        length = data.draw(st.integers(0, 12))
        piece = data.draw(
            st.sampled_from(["", "\t", "- ", ": ", "{", "}", "[]", "null", "not: ", "*a", "'", "1.5", "\n", "\r"])
        )
        text = text[:start] + piece + text[start + length :]
    path = tmp_path_factory.getbasetemp() / "mutated.yaml"
    path.write_bytes(text.encode())
    assert sound(problems_of(lambda: load_rules([path], words, operators, probes, shipped=False)))


_KEYS = st.sampled_from(
    [
        "fact",
        "field",
        "op",
        "value",
        "not",
        "any_of",
        "exists",
        "for_all",
        "where",
        "then",
        "threshold",
        "add",
        "finding",
    ]
)
_TREES = st.recursive(
    st.sampled_from([None, True, 1, 0.5, "brightness", "offset_dn", "gt", "brightness.offset_dn"]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(_KEYS, inner, max_size=3),
    max_leaves=12,
)


@seed(3)
@FUZZ
@given(condition=_TREES, action=_TREES)
def test_any_tree_as_condition_and_action_is_accepted_or_refused(
    condition, action, good_text, words, operators, probes, tmp_path_factory
):
    path = tmp_path_factory.getbasetemp() / "tree.yaml"
    rule = {
        "id": "COR009", "name": "x", "stage": "correction", "when": [condition], "then": [action],
        "because": "A reason that is long.", "references": ["x"],
    }  # fmt: skip
    path.write_text(good_text + "  - " + json.dumps(rule) + "\n")
    assert sound(problems_of(lambda: load_rules([path], words, operators, probes, shipped=False)))
