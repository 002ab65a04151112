"""A decision record as Markdown; texts from files appear as text, never as markup."""

from __future__ import annotations

from collections.abc import Container

from expert.decision import Decision
from expert.report.answers import Answers, answer
from expert.report.rows import fact_rows
from expert.report.text import sections
from expert.report.verdict import verdict

_PICTURES = (
    ("left_corrected.png", "Left image after correction"),
    ("right_corrected.png", "Right image after correction"),
    ("disparity_view.png", "Disparity: near is red, far is blue, black has none"),
    ("confidence.png", "Probability that the disparity is right: white is certain"),
    ("elevation.png", "Relief of the terrain from above, forward is up"),
    ("traversability.png", "Where the rover may go"),
    ("ortho.png", "The ground from above"),
)


def _escape(text: str) -> str:
    for character in "\\`*_<>[]|#&":
        text = text.replace(character, "\\" + character)
    return text.replace("\n", " ")


def as_markdown(decision: Decision, answers: Answers | None = None, files: Container[str] = ()) -> str:
    """Return the report as Markdown; texts from files appear as text, never as markup.

    Parameters
    ----------
    decision : Decision
    answers : Answers, optional
        Of `answer(decision)`, where they are known already.
    files : container of str
        Names of the files of the run; the pictures among them are linked.
    """
    answers = answers or answer(decision)
    told = verdict(decision)
    lines = [f"# {_escape(decision.pair)}", ""]
    lines += [f"- {_escape(sentence)}" for sentence in (told.wrong, told.done, told.trust)] + [""]
    for section in sections(decision, answers):
        if section.lines:
            lines += [f"## {section.title}", ""]
            lines += [("  - " if line.startswith("    ") else "- ") + _escape(line.strip()) for line in section.lines]
            lines.append("")
    lines += ["## All facts", "", "| fact | value | range | measured by | nearest limit |", "|---|---|---|---|---|"]
    for row in fact_rows(decision, answers):
        cells = (row.name, f"{row.value} {row.unit}".strip(), row.limits, row.probe, row.nearest)
        lines.append("| " + " | ".join(_escape(cell) for cell in cells) + " |")
    shown = [(name, words) for name, words in _PICTURES if name in files]
    if shown:
        lines += ["", "## Pictures", *(line for name, words in shown for line in ("", f"![{words}]({name})"))]
    return "\n".join(lines) + "\n"
