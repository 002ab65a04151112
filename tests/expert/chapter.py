"""Run a chapter: files as it shows them, commands as it types them, and the true output of each.

In the chapter, a block ```yaml NAME is a file to write, ```diff NAME an edit to a file, ```console what is typed after
`$` and what is printed; a line `...` stands for any lines, ` ...` at the end of one for its rest. An edit with the word
`broken` beside the name is undone after the next console block.

`python tests/expert/chapter.py docs/newcomers_hour.md` writes the true output into the chapter.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

BLOCK = re.compile(r"^```(\w+)([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Block:
    """One fenced block: its language, the words after it, its text, and where the text stands in the chapter."""

    language: str
    words: tuple[str, ...]
    text: str
    span: tuple[int, int]


@dataclass(frozen=True)
class Typed:
    """One command of a console block, what the chapter says it prints, and what it prints."""

    command: str
    shown: str
    printed: str
    code: int

    @property
    def true(self) -> bool:
        """Whether the chapter shows what is printed."""
        lines = re.split(r"^\.\.\.\n", self.shown, flags=re.MULTILINE)
        parts = [".*".join(map(re.escape, part.split(" ..."))) for part in lines]
        return re.fullmatch("(?:.*\n)*".join(parts), self.printed) is not None


def blocks(chapter: str) -> list[Block]:
    return [Block(m[1], tuple(m[2].split()), m[3], m.span(3)) for m in BLOCK.finditer(chapter)]


def terrex(arguments: list[str]) -> tuple[str, int]:
    """Run the command line in this process; return what it prints and its exit code."""
    from expert.cli import main

    printed, code = io.StringIO(), 0
    patched = mock.patch.object(sys, "argv", ["terrex", *arguments])
    with patched, contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
        try:
            main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
    return printed.getvalue(), code


def typed(command: str) -> tuple[str, int]:
    words = shlex.split(command)
    assert words[0] == "terrex", command
    if ">" in words:
        printed, code = terrex(words[1 : words.index(">")])
        Path(words[-1]).write_text(printed, encoding="utf-8")
        return "", code
    return terrex(words[1:])


def edited(text: str, diff: str) -> str:
    """Apply an edit that shows the old lines after -, the new ones after + and any others as they are."""
    old = "".join(f"{line[1:]}\n" for line in diff.splitlines() if not line.startswith("+"))
    new = "".join(f"{line[1:]}\n" for line in diff.splitlines() if not line.startswith("-"))
    assert text.count(old) == 1, f"to be edited, but there {text.count(old)} times:\n{old}"
    return text.replace(old, new)


def walk(chapter: str) -> Iterator[tuple[Block, Typed]]:
    """Do what a chapter says, in the working directory."""
    undo: dict[Path, str] = {}
    for block in blocks(chapter):
        if block.language == "yaml" and block.words:
            path = Path(block.words[0])
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.text, encoding="utf-8")
        elif block.language == "diff":
            path = Path(block.words[0])
            before = path.read_text(encoding="utf-8")
            path.write_text(edited(before, block.text), encoding="utf-8")
            if "broken" in block.words:
                undo[path] = before
        elif block.language == "console":
            for part in re.split(r"^\$ ", block.text, flags=re.MULTILINE)[1:]:
                command, _, shown = part.partition("\n")
                printed, code = typed(command)
                yield block, Typed(command, shown, printed, code)
            for path, before in undo.items():
                path.write_text(before, encoding="utf-8")
            undo.clear()


def renewed(chapter: str) -> str:
    """Return a chapter with the true output of every command; outputs shown in part stay."""
    texts: dict[tuple[int, int], str] = {}
    for block, item in walk(chapter):
        in_part = "...\n" in item.shown
        if in_part and not item.true:
            print(f"not shown truly: {item.command}\n{item.printed}")
        printed = item.shown if in_part else item.printed
        texts[block.span] = texts.get(block.span, "") + f"$ {item.command}\n{printed}"
    for (start, end), text in sorted(texts.items(), reverse=True):
        chapter = chapter[:start] + text + chapter[end:]
    return chapter


if __name__ == "__main__":
    file = Path(sys.argv[1]).resolve()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        text = renewed(file.read_text(encoding="utf-8"))
        os.chdir("/")
    file.write_text(text, encoding="utf-8")
