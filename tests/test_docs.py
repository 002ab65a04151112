"""Every command and code block of the documentation runs, in the order of its page, as a reader would run it.

A `console` block holds commands behind `$ `; `# exit 1` behind a command states its exit code; the lines that follow
must occur in its output in that order, `...` stands for any. A block with a title is a file. A `python` block is run
after the ones before it on its page.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"
PAGES = sorted([DOCS / "tutorial.md", *(DOCS / "how-to").glob("*.md")])
BLOCK = re.compile(r"^```(\w+)(?: title=\"([^\"]+)\")?\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_blocks_of_the_page_run(page: Path, tmp_path: Path) -> None:
    before = ""
    blocks = BLOCK.findall(page.read_text(encoding="utf-8"))
    assert blocks, "the page has no block that could run"
    for language, title, text in blocks:
        if title:
            (tmp_path / title).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / title).write_text(text, encoding="utf-8")
        elif language == "console":
            for command, code, expected in _commands(text):
                said = _run(["bash", "-c", command], tmp_path, code)
                _check(command, expected, said)
        elif language == "python":
            before += text
            _run([sys.executable, "-c", before], tmp_path, 0)


def _commands(text: str) -> list[tuple[str, int, list[str]]]:
    found: list[tuple[str, int, list[str]]] = []
    for line in re.sub(r"\\\n", " ", text).splitlines():
        if line.startswith("$ "):
            command, _, code = line[2:].partition("  # exit ")
            found.append((command, int(code or 0), []))
        elif line.strip():
            found[-1][2].append(line.strip())
    return found


def _run(words: list[str], folder: Path, code: int) -> str:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(
        words,
        cwd=folder,
        env={**os.environ, "PATH": path, "COLUMNS": "160", "PYTHONUNBUFFERED": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == code, f"{words[-1]}\nended with {done.returncode}\n{done.stdout}"
    return done.stdout


def _check(command: str, expected: list[str], said: str) -> None:
    at = 0
    for line in expected:
        if line == "...":
            continue
        found = said.find(line, at)
        assert found >= 0, f"{command}\nshould print (after what came before)\n{line}\nbut printed\n{said}"
        at = found + len(line)
