"""Renderings of a decision record: terminal text, Markdown and HTML. They run nothing and measure no pair."""

from expert.report.html import as_html
from expert.report.markdown import as_markdown
from expert.report.pictures import PICTURES
from expert.report.saved import read_run, render_again
from expert.report.text import as_text, fact_text, verdict

__all__ = ["PICTURES", "as_html", "as_markdown", "as_text", "fact_text", "read_run", "render_again", "verdict"]
