"""Renderings of a decision record: terminal text, Markdown and HTML. They run nothing and measure no pair."""

from expert.report.answers import Answers, answer
from expert.report.html import as_html
from expert.report.markdown import as_markdown
from expert.report.pictures import FILES
from expert.report.saved import read_decision, read_run, render_again
from expert.report.text import as_outline, as_summary, as_text
from expert.report.verdict import Verdict, verdict
from expert.report.words import fact_text

__all__ = [
    "FILES",
    "Answers",
    "Verdict",
    "answer",
    "as_html",
    "as_markdown",
    "as_outline",
    "as_summary",
    "as_text",
    "fact_text",
    "read_decision",
    "read_run",
    "render_again",
    "verdict",
]
