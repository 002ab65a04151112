"""Every faulty file is refused with exactly the words in the golden file beside it."""

from __future__ import annotations

from pathlib import Path

import pytest

from expert.rules.load import load_rules
from expert.rules.problem import RuleFileError

BAD = sorted((Path(__file__).parent / "bad").glob("*.bad.yaml"))


@pytest.mark.parametrize("path", BAD, ids=lambda path: path.name)
def test_a_bad_file_is_refused_in_these_words(path, words, operators, probes, monkeypatch):
    monkeypatch.chdir(path.parent)
    with pytest.raises(RuleFileError) as caught:
        load_rules([Path(path.name)], words, operators, probes, shipped=False)
    assert str(caught.value) + "\n" == path.with_suffix(".txt").read_text()
