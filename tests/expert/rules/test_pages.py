"""The reference pages cover everything that is there, and every link leads somewhere."""

from __future__ import annotations

import posixpath
import re

import pytest

from expert.facts import vocabulary
from expert.rules.cases import read_cases
from expert.rules.checks.catalog import CHECKS
from expert.rules.load import load_rules
from expert.rules.pages import Reference, anchor, pages
from modules.catalog import operators, probes


@pytest.fixture(scope="module")
def reference():
    words = vocabulary(probes().values())
    loaded = load_rules(None, words, operators(), probes())
    return Reference(loaded, read_cases(loaded.merged, words)[0], words, operators(), probes())


@pytest.fixture(scope="module")
def made(reference):
    return pages(reference)


def headings(text):
    return re.findall(r"^#+ (.+)$", text, re.MULTILINE)


def test_every_rule_has_a_page_with_its_conditions_actions_and_cases(reference, made):
    for rule in reference.rules:
        text = made[f"rules/{rule.id}.md"]
        assert text.startswith(f"# {rule.id} {rule.name}\n")
        assert text.count("\n- ") >= len(rule.when) + len(rule.then)
        assert all(reference_ in text for reference_ in rule.references)
        (file,) = [item for item in reference.cases if item.rule == rule.id]
        assert f"## Cases ({len(file.cases)})" in text
        assert all(f"- {case.name}: " in text for case, _ in file.cases)


def test_everything_that_rules_may_name_has_a_heading(reference, made):
    base = reference.loaded.base
    assert set(headings(made["facts.md"])) == {"Facts", *reference.vocabulary}
    assert set(headings(made["operators.md"])) == {"Operators", *operators()}
    assert set(headings(made["thresholds.md"])) == {"Thresholds", *base.thresholds}
    assert set(headings(made["findings.md"])) == {"Findings", *base.findings}
    assert all(f"| {slot.slot} |" in made["slots.md"] for slots in base.slots.values() for slot in slots)
    for template in reference.vocabulary.values():
        assert all(f"| {name} |" in made["facts.md"] for name in template.fields)
    for operator in operators().values():
        assert all(f"| {name} |" in made["operators.md"] for name in operator.params.model_fields)


def test_every_code_has_a_page_with_the_message_it_gives(made):
    assert {path for path in made if path.startswith("checks/")} == {f"checks/{code}.md" for code in CHECKS}
    for code in set(CHECKS) - {"unreadable", "too-large"}:
        assert re.search(rf"^rig\.yaml:\d+:\d+: (note: )?{code}: ", made[f"checks/{code}.md"], re.MULTILINE), code


def test_no_link_is_broken(made):
    anchors = {path: {anchor(name) for name in headings(text)} for path, text in made.items()}
    count = 0
    for path, text in made.items():
        for link in re.findall(r"\]\(([^)]+)\)", text):
            target, _, mark = link.partition("#")
            where = posixpath.normpath(posixpath.join(posixpath.dirname(path), target))
            assert where in made, (path, link)
            assert not mark or mark in anchors[where], (path, link)
            count += 1
    assert count > 300


def test_a_page_is_the_same_every_time(reference, made):
    assert pages(reference) == made
