"""A decision record as Markdown; texts from files appear as text, never as markup."""

from __future__ import annotations

from expert.decision import Decision
from expert.report.text import fact_text, sections, verdict


def _escape(text: str) -> str:
    for character in "\\`*_<>[]|#":
        text = text.replace(character, "\\" + character)
    return text.replace("\n", " ")


def as_markdown(decision: Decision) -> str:
    """Return the report as Markdown; texts from files appear as text, never as markup."""
    lines = [f"# {_escape(decision.pair)}", "", _escape(verdict(decision)), ""]
    for title, items in sections(decision):
        if items:
            lines += [f"## {title}", ""]
            lines += [("  - " if item.startswith("    ") else "- ") + _escape(item.strip()) for item in items] + [""]
    lines += ["## All facts", "", "| fact | measured by |", "|---|---|"]
    lines += [f"| {_escape(fact_text(fact))} | {_escape(fact.probe or 'stated')} |" for fact in decision.facts]
    lines += ["", "## Record", "", f"- decision {decision.id}, rules {decision.rules_digest[:16]}"]
    lines += [f"- {_escape(name)} {_escape(number)}" for name, number in decision.versions.items()]
    lines += ["", "## Time", "", "| what | s |", "|---|---|"]
    spent = sorted(decision.timings_s.items(), key=lambda item: -item[1])
    lines += [f"| {_escape(name)} | {seconds:.3f} |" for name, seconds in spent]
    return "\n".join(lines) + "\n"
