from __future__ import annotations

import pytest

from expert.rules.load import load_rules
from expert.rules.problem import RuleFileError
from expert.rules.reader import MAX_BYTES, read_document


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


def test_a_key_that_looks_like_a_type_is_an_unknown_key(load, good_text):
    with pytest.raises(RuleFileError) as caught:
        load(good_text.replace("    references: [measured]\n  - id", "    r[]eferences: [measured]\n  - id"))
    assert [item.code for item in caught.value.problems] == ["missing-reference", "unknown-key"]


def test_what_is_sound_of_a_faulty_rule_is_checked_too(load, good_text):
    text = good_text.replace("because: Costs that use raw intensity read it as mismatch.", 'because: ""')
    text = text.replace("{derive: exposure-differs, severity: major}", "{derive: exposure-differs, severity: mayor}")
    with pytest.raises(RuleFileError) as caught:
        load(text.replace("field: offset_dn, op: abs_ge", "field: ofset_dn, op: abs_ge"))
    assert [item.code for item in caught.value.problems] == [
        "unknown-field", "unknown-value", "missing-rationale",
    ]  # fmt: skip


def test_numbers_are_read_as_people_read_them():
    data = read_document("x.yaml", b'[1, -2, 0.5, 1e3, .5, "1", true, null, text]').data
    assert data == [1, -2, 0.5, 1000.0, 0.5, "1", True, None, "text"]
