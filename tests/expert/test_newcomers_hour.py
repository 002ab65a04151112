"""The newcomer's hour, as it is written: its files, its edits, its commands, and what they print."""

from __future__ import annotations

from pathlib import Path

import pytest
from chapter import Typed, blocks, edited, walk

CHAPTER = Path(__file__).parents[2] / "docs" / "newcomers_hour.md"


def test_the_chapter_shows_what_is_printed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = CHAPTER.read_text(encoding="utf-8")
    done = [item for _, item in walk(text)]
    for item in done:
        assert item.true, f"$ {item.command}\nis shown to print\n{item.shown}\nand prints\n{item.printed}"
    assert sum(item.code != 0 for item in done) >= 10
    assert done[-1].code == 0


def test_the_chapter_breaks_two_rules_in_five_ways_each():
    text = CHAPTER.read_text(encoding="utf-8")
    first, _, second = text.partition("## A rule that chooses")
    assert [sum("broken" in block.words for block in blocks(part)) for part in (first, second)] == [5, 5]


def test_a_chapter_that_lies_is_noticed():
    assert Typed("terrex x", "a\n...\nd\n", "a\nb\nc\nd\n", 0).true
    assert not Typed("terrex x", "a\n...\nd\n", "a\nb\nc\n", 0).true
    assert not Typed("terrex x", "a\n", "a\nb\n", 0).true


def test_an_edit_has_to_meet_one_place():
    assert edited("a\nb\nc\n", "-b\n+x\n c\n") == "a\nx\nc\n"
    with pytest.raises(AssertionError, match="there 2 times"):
        edited("b\nb\n", "-b\n+x\n")
