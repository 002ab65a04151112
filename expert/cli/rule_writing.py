"""Commands of `terrex rules` for those who write rules: graph, new, fmt and diff."""

from __future__ import annotations

from typing import Annotated, Optional

import typer

from expert.cli.rule_common import Layers, known, load
from expert.rules.graph import as_mermaid, rule_graph
from expert.rules.model import Stage
from modules.catalog import operators, probes


def graph(
    ids: Annotated[Optional[list[str]], typer.Argument(help="Rule ids; all rules without any.")] = None,  # noqa: UP045
    rules: Layers = None,
    stage: Annotated[Optional[Stage], typer.Option("--stage", help="Only the rules of one stage.")] = None,  # noqa: UP045
) -> None:
    """Draw rules with the facts and findings they read, and the findings, slots and probes they write, as Mermaid."""
    loaded = load(rules)
    for name in ids or []:
        known(loaded, name)
    chosen = [
        rule.id for rule in loaded.base.rules if (not ids or rule.id in ids) and (not stage or rule.stage == stage)
    ]
    typer.echo(as_mermaid(rule_graph(loaded.base, operators(), probes(), chosen)), nl=False)
