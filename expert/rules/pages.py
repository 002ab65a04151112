"""Reference pages in Markdown: rules with their cases, facts, operators, check codes, thresholds, findings and slots.

Everything is read from the rule base, its cases, the vocabulary and the catalogs, so that no page can be out of date.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from expert.facts import FieldInfo, TemplateInfo, Vocabulary
from expert.rules.cases import Case, CaseFile, GivenFinding
from expert.rules.check import check_rules
from expert.rules.checks.catalog import CHECKS
from expert.rules.checks.check import Check
from expert.rules.checks.context import asked_by, derived_by, named_operators, thresholds_in, walk
from expert.rules.checks.examples import EXAMPLES, OVER_SHIPPED
from expert.rules.checks.parameters import limits_of
from expert.rules.explain import action_text, condition_text
from expert.rules.load import LoadedRules
from expert.rules.model import STAGES, Comparison, Rule
from modules.operator import Operator
from modules.probe import Probe


@dataclass(frozen=True)
class Reference:
    """All that the pages are made of."""

    loaded: LoadedRules
    cases: Sequence[CaseFile]
    vocabulary: Vocabulary
    operators: Mapping[str, Operator]
    probes: Mapping[str, Probe]

    @property
    def rules(self) -> list[Rule]:
        """The rules by id."""
        return sorted(self.loaded.base.rules, key=lambda rule: rule.id)


def pages(reference: Reference) -> dict[str, str]:
    """Return every page by its path below one folder."""
    made = {
        "README.md": _start(reference),
        "rules.md": _rule_index(reference),
        "facts.md": _facts(reference),
        "operators.md": _operators(reference),
        "thresholds.md": _thresholds(reference),
        "findings.md": _findings(reference),
        "slots.md": _slots(reference),
        "checks.md": _check_index(),
    }
    for rule in reference.rules:
        made[f"rules/{rule.id}.md"] = _rule(reference, rule)
    for check in CHECKS.values():
        made[f"checks/{check.code}.md"] = _check(reference, check)
    return {path: text.rstrip() + "\n" for path, text in made.items()}


def _cell(text: object) -> str:
    return " ".join(str(text).split()).replace("|", "\\|")


def _table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    lines += [f"| {' | '.join(_cell(item) for item in row)} |" for row in rows]
    return "\n".join(lines) + "\n"


def _rule_links(ids: Iterable[str], up: str = "") -> str:
    return ", ".join(f"[{name}]({up}rules/{name}.md)" for name in sorted(ids)) or "none"


def _start(reference: Reference) -> str:
    base = reference.loaded.base
    rows = (
        ("[Rules](rules.md)", len(base.rules), "what is done when, why, and the cases that prove it"),
        ("[Facts](facts.md)", len(reference.vocabulary), "what rules may ask about, with units and ranges"),
        ("[Operators](operators.md)", len(reference.operators), "what rules may choose, with parameters and ranges"),
        ("[Thresholds](thresholds.md)", len(base.thresholds), "numbers that several rules share"),
        ("[Findings](findings.md)", len(base.findings), "what rules conclude, as the user reads it"),
        ("[Slots](slots.md)", sum(map(len, base.slots.values())), "places of the plan and their defaults"),
        ("[Checks](checks.md)", len(CHECKS), "what `terrex rules check` reports"),
    )
    return f"# Reference\n\nGenerated from rule base `{reference.loaded.digest}`.\n\n" + _table(
        ("", "number", ""), rows
    )


def _rule_index(reference: Reference) -> str:
    text = "# Rules\n"
    for stage in STAGES:
        rules = [rule for rule in reference.rules if rule.stage == stage]
        if rules:
            rows = [(f"[{rule.id}](rules/{rule.id}.md)", rule.name, rule.because) for rule in rules]
            text += f"\n## {stage}\n\n" + _table(("id", "name", "because"), rows)
    return text


def _rule(reference: Reference, rule: Rule) -> str:
    base, words = reference.loaded.base, reference.vocabulary
    file, line = reference.loaded.positions[rule.id]
    text = f"# {rule.id} {rule.name}\n\nStage {rule.stage}, priority {rule.priority}; `{file}:{line}`.\n\n"
    text += "**When**\n\n" + "".join(f"- {condition_text(item, words, base.thresholds)}\n" for item in rule.when)
    text += "\n**Then**\n\n" + "".join(f"- {action_text(item, base.thresholds)}\n" for item in rule.then)
    text += f"\n**Because** {' '.join(rule.because.split())}\n\n**References:** {'; '.join(rule.references)}\n\n"
    text += "".join(f"- {line}\n" for line in _links_of(rule, reference.operators))
    cases = [case for item in reference.cases if item.rule == rule.id for case, _ in item.cases]
    text += f"\n## Cases ({len(cases)})\n\n" + "".join(_case(case) for case in cases)
    return text


def _links_of(rule: Rule, known: Mapping[str, Operator]) -> Iterator[str]:
    """Yield what a rule speaks of, as links."""
    facts = {item.fact for item, _, _ in walk(rule) if isinstance(item, Comparison)}
    operators = {name for action in rule.then for name, _, _ in named_operators(action, ()) if name in known}
    for label, page, names in (
        ("Facts", "facts", facts),
        ("Findings asked for", "findings", asked_by(rule)),
        ("Findings derived", "findings", set(derived_by(rule))),
        ("Thresholds", "thresholds", thresholds_in(rule)),
        ("Operators", "operators", operators),
    ):
        if names:
            yield f"{label}: " + ", ".join(f"[{name}](../{page}.md#{anchor(name)})" for name in sorted(names))


def _case(case: Case) -> str:
    given = [
        f"{item['fact']}: " + ", ".join(f"{name} {value}" for name, value in item.items() if name != "fact")
        for item in case.facts
    ]
    given += [
        f"finding {item.finding} ({item.severity})" if isinstance(item, GivenFinding) else f"finding {item}"
        for item in case.findings
    ]
    wish = case.expect.model_dump(by_alias=True, exclude_defaults=True) if case.expect else {}
    expected = f", and it does: {', '.join(f'{name} {value}' for name, value in wish.items())}" if wish else ""
    verdict = "it fires" if case.fires else "it stays quiet"
    return f"- {case.name}: given {'; '.join(given) or 'nothing'}, {verdict}{expected}\n"


def anchor(name: str) -> str:
    """Return the anchor of a heading, as code hosts make it."""
    return "".join(letter for letter in name.lower().replace(" ", "-") if letter.isalnum() or letter in "-_")


def _users(reference: Reference, uses: Mapping[str, set[str]], name: str) -> str:
    return _rule_links(uses.get(name, set()))


def _by_name(pairs: Iterable[tuple[str, str]]) -> dict[str, set[str]]:
    found: dict[str, set[str]] = {}
    for name, rule in pairs:
        found.setdefault(name, set()).add(rule)
    return found


def _range(info: FieldInfo) -> str:
    if info.choices:
        return ", ".join(info.choices)
    if info.ge is None and info.le is None:
        return info.kind
    return f"{'' if info.ge is None else f'{info.ge:g}'} to {'' if info.le is None else f'{info.le:g}'}"


def _fact(reference: Reference, template: TemplateInfo, uses: Mapping[str, set[str]]) -> str:
    source = f"Measured by `{template.probe}` ({template.tier})." if template.probe else "Stated, not measured."
    keys = f" One fact per {', '.join(template.keys)}." if template.keys else ""
    rows = [
        (
            info.name,
            info.unit,
            _range(info),
            "" if info.resolution is None else f"{info.resolution:g}",
            info.description,
        )
        for info in template.fields.values()
    ]
    return (
        f"## {template.name}\n\n{template.description} {source}{keys}\n\n"
        + _table(("field", "unit", "range", "rounded to", "what it is"), rows)
        + f"\nRules: {_users(reference, uses, template.name)}\n\n"
    )


def _facts(reference: Reference) -> str:
    uses = _by_name(
        (item.fact, rule.id) for rule in reference.rules for item, _, _ in walk(rule) if isinstance(item, Comparison)
    )
    text = "# Facts\n\nUnit 1 is a pure number; `_dn` is on the scale of 0 to 255.\n\n"
    return text + "".join(_fact(reference, item, uses) for _, item in sorted(reference.vocabulary.items()))


def _kind(annotation: Any) -> str:
    choices = getattr(annotation, "__args__", ())
    if choices and all(isinstance(item, str) for item in choices):
        return ", ".join(choices)
    return {int: "whole number", float: "number", bool: "true or false", str: "text"}.get(annotation, "value")


def _parameter(operator: Operator, name: str) -> tuple[object, ...]:
    info = operator.params.model_fields[name]
    low, high = limits_of(operator.params, name)
    limits = "" if (low, high) == (float("-inf"), float("inf")) else f"{low:g} to {high:g}"
    return name, info.default, limits or _kind(info.annotation), info.description or ""


def _operators(reference: Reference) -> str:
    uses = _by_name(
        (name, rule.id)
        for rule in reference.rules
        for action in rule.then
        for name, _, _ in named_operators(action, ())
    )
    text = "# Operators\n\n"
    for name, item in sorted(reference.operators.items()):
        needs = f" Needs {', '.join(item.needs)}." if item.needs else ""
        cost = item.cost
        text += f"## {name}\n\nFills slot `{item.stage}.{item.slot}`. {item.summary} {item.suits}{needs}\n\n"
        text += (
            f"Cost: {cost.fixed_ms:g} ms, {cost.ns_per_pixel:g} ns per pixel, "
            f"{cost.ns_per_pixel_disparity:g} ns per pixel and disparity.\n\n"
        )
        if item.params.model_fields:
            rows = [_parameter(item, parameter) for parameter in item.params.model_fields]
            text += _table(("parameter", "default", "range", "what it is"), rows) + "\n"
        text += f"Rules: {_users(reference, uses, name)}\n\n"
    return text


def _thresholds(reference: Reference) -> str:
    uses = _by_name((name, rule.id) for rule in reference.rules for name in thresholds_in(rule))
    text = "# Thresholds\n\n"
    for name, item in sorted(reference.loaded.base.thresholds.items()):
        unit = "" if item.unit == "1" else f" {item.unit}"
        text += f"## {name}\n\n{item.value:g}{unit}: {item.because}\n\nRules: {_users(reference, uses, name)}\n\n"
    return text


def _findings(reference: Reference) -> str:
    derived = _by_name((name, rule.id) for rule in reference.rules for name in derived_by(rule))
    asked = _by_name((name, rule.id) for rule in reference.rules for name in asked_by(rule))
    text = "# Findings\n\n"
    for name, sentence in sorted(reference.loaded.base.findings.items()):
        text += f"## {name}\n\n{sentence}\n\nDerived by: {_users(reference, derived, name)}\n\n"
        text += f"Asked for by: {_users(reference, asked, name)}\n\n"
    return text


def _slots(reference: Reference) -> str:
    text = "# Slots\n\nThe default answers when no rule chooses, and loses to any rule that does.\n"
    for stage, slots in reference.loaded.base.slots.items():
        rows = []
        for slot in slots:
            fill = [item.name for item in reference.operators.values() if (item.stage, item.slot) == (stage, slot.slot)]
            links = ", ".join(f"[{name}](operators.md#{anchor(name)})" for name in sorted(fill))
            values = ", ".join(f"{name} {value}" for name, value in slot.with_.items())
            rows.append((slot.slot, slot.default + (f" ({values})" if values else ""), slot.because, links))
        text += f"\n## {stage}\n\n" + _table(("slot", "default", "because", "operators"), rows)
    return text


def _check_index() -> str:
    rows = [(f"[{check.code}](checks/{check.code}.md)", check.level, check.reports) for check in CHECKS.values()]
    return (
        "# Checks\n\n`terrex rules check` reports them as `file:line:column: code: sentence; hint`. Errors keep rules "
        "from loading. A warning or note is silenced by `# terrex: ignore[code] reason` on its line or the line above; "
        "notes do not make the check fail.\n\n" + _table(("code", "level", "reports"), rows)
    )


def _check(reference: Reference, check: Check) -> str:
    text = f"# {check.code}\n\n{check.level.capitalize()}. {check.reports}\n\n{check.why}\n\n"
    text += f"**What to do:** {check.remedy}\n"
    bad, good = EXAMPLES / f"{check.code}.bad.yaml", EXAMPLES / f"{check.code}.good.yaml"
    if not bad.is_file():
        return text
    before, after = (path.read_text(encoding="utf-8", errors="replace").splitlines() for path in (good, bad))
    lines = difflib.unified_diff(before, after, n=1, lineterm="")
    changes = "\n".join(line for line in lines if not line.startswith(("---", "+++", "@@")))
    said = "\n".join(_messages(reference, check, bad))
    return f"{text}\n## Example\n\nWith the line marked +\n\n```diff\n{changes}\n```\n\nit says\n\n```\n{said}\n```\n"


def _messages(reference: Reference, check: Check, path: Path) -> list[str]:
    found = check_rules(
        [path],
        reference.vocabulary,
        reference.operators,
        reference.probes,
        shipped=check.code in OVER_SHIPPED,
        cases=EXAMPLES / "cases",
        with_cases=check.code == "missing-case",
    )
    return [str(problem).replace(str(path), "rig.yaml") for problem in found]
