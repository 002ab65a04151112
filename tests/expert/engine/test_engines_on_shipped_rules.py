"""Both engines agree on the shipped rules, whatever is measured."""

from __future__ import annotations

import random
from collections.abc import Mapping
from typing import Any

from expert.engine.compiled import CompiledEngine
from expert.engine.experta_engine import ExpertaEngine
from expert.facts import Fact, FieldInfo, TemplateInfo, vocabulary
from expert.rules.load import load_rules
from expert.rules.model import STAGES
from modules.catalog import operators, probes

FACT_SETS = 25


def drawn_facts(words: Mapping[str, TemplateInfo], findings: list[str], source: random.Random) -> list[Fact]:
    """Return up to two facts per template, with fields within their ranges and some of them absent."""
    found = []
    for name in sorted(words):
        for _ in range(source.choice((0, 1, 1, 2))):
            fields = words[name].fields
            values = {key: drawn_value(info, findings, source) for key, info in fields.items()}
            found.append(Fact.of(name, **{key: value for key, value in values.items() if source.random() < 0.9}))
    return found


def drawn_value(info: FieldInfo, findings: list[str], source: random.Random) -> Any:
    if info.kind == "boolean":
        return source.random() < 0.5
    if info.kind == "text":
        return source.choice(info.choices or findings)
    low = -10.0 if info.ge is None else info.ge
    high = max(low, 10.0 if info.le is None else info.le)
    number = source.choice((low, source.uniform(low, high), source.uniform(low, low + 0.05 * (high - low)), 0.0))
    return int(number) if info.kind == "integer" else number


def test_both_engines_agree_on_the_shipped_rules() -> None:
    words = vocabulary(probes().values())
    base = load_rules(None, words, operators(), probes()).base
    compiled, experta = CompiledEngine(words), ExpertaEngine(words)
    findings = sorted(base.findings) or ["none"]
    fired: set[str] = set()
    for seed in range(FACT_SETS):
        facts = drawn_facts(words, findings, random.Random(seed))
        for stage in STAGES:
            expected = compiled.infer(base, stage, facts)
            assert repr(experta.infer(base, stage, facts).firings) == repr(expected.firings), f"seed {seed}, {stage}"
            fired |= {firing.rule for firing in expected.firings}
    assert fired, "no shipped rule fires for any of the facts"
