"""Write the pages that are generated from the code into docs/generated: rules, facts, operators, checks, commands.

python docs/generate.py
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import typer.main
from typer.cli import get_docs_for_click

from expert.cli.commands import complete_app

GENERATED = Path(__file__).parent / "generated"


def main() -> None:
    command = typer.main.get_command(complete_app())
    context = command.make_context("terrex", [], resilient_parsing=True)
    GENERATED.mkdir(exist_ok=True)
    page = get_docs_for_click(obj=command, ctx=context, name="terrex")
    (GENERATED / "command-line.md").write_text(page.replace("# `terrex`", "# Command line", 1), encoding="utf-8")
    terrex = [sys.executable, "-c", "from expert.cli import main; main()"]
    subprocess.run([*terrex, "rules", "pages", "--out", str(GENERATED / "rules")], check=True)


if __name__ == "__main__":
    main()
