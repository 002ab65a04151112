"""Every command and code block of the documentation runs, in the order of its page, as a reader would run it.

A `console` block holds commands behind `$ `; `# exit 1` behind a command states its exit code; the lines that follow
must occur in its output in that order, `...` stands for any. A block with a title is a file. A `python` block is run
after the ones before it on its page. A comment `<!-- run` holds commands that prepare what the reader has already.
The newcomer's hour has a test of its own, which compares every printed line.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
ELSEWHERE = {DOCS / "newcomers_hour.md"}
RUN = ("console", "python")
BLOCK = re.compile(r"^```(\w+)(?: title=\"([^\"]+)\")?\n(.*?)^```$|^<!-- (run)()\n(.*?)^-->$", re.MULTILINE | re.DOTALL)


def found(page: Path) -> list[tuple[str, str, str]]:
    """Return language, title and text of the blocks of a page."""
    matches = BLOCK.finditer(page.read_text(encoding="utf-8"))
    return [(m[1] or m[4], m[2] or "", m[3] or m[6]) for m in matches]


def pages() -> list[Path]:
    """Return the pages that have a block to run."""
    written = [
        ROOT / "README.md",
        *DOCS.glob("*.md"),
        *(DOCS / "how-to").glob("*.md"),
        *(DOCS / "reference").glob("*.md"),
    ]
    return sorted(page for page in written if page not in ELSEWHERE and any(b[0] in RUN for b in found(page)))


def test_every_page_that_leads_through_something_has_a_block_to_run() -> None:
    leading = {ROOT / "README.md", DOCS / "tutorial.md", *(DOCS / "how-to").glob("*.md")}
    assert leading <= set(pages())


def test_pages_have_only_blocks_that_run_or_files_or_output() -> None:
    for page in [ROOT / "README.md", *DOCS.rglob("*.md")]:
        if page not in ELSEWHERE and "generated" not in page.parts:
            strange = [b[0] for b in found(page) if b[0] not in (*RUN, "run", "text", "sh") and not b[1]]
            assert not strange, f"{page}: a block of {strange} that nothing runs"


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.stem)
def test_the_blocks_of_the_page_run(page: Path, tmp_path: Path) -> None:
    before = ""
    for language, title, text in found(page):
        if title:
            (tmp_path / title).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / title).write_text(text, encoding="utf-8")
        elif language == "run":
            _run(["bash", "-ec", text], tmp_path, 0)
        elif language == "console":
            for command, code, expected in _commands(text):
                said = _run(["bash", "-c", command], tmp_path, code)
                _check(command, expected, said)
        elif language == "python":
            before += text
            _run([sys.executable, "-c", before], tmp_path, 0)


def _commands(text: str) -> list[tuple[str, int, list[str]]]:
    typed: list[tuple[str, int, list[str]]] = []
    for line in re.sub(r"\\\n", " ", text).splitlines():
        if line.startswith("$ "):
            command, _, code = line[2:].partition("  # exit ")
            typed.append((command, int(code or 0), []))
        elif line.strip():
            typed[-1][2].append(line.strip())
    return typed


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
        place = said.find(line, at)
        assert place >= 0, f"{command}\nshould print (after what came before)\n{line}\nbut printed\n{said}"
        at = place + len(line)
