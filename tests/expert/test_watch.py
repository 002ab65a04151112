from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from synthetic_pairs import shifted_pair

from expert.api import ExpertSystem
from expert.cli.rule_watch import follow
from expert.watch import Watch, stamp
from modules.catalog import probes

RIG = """version: 1
rules:
  - id: MAT900
    name: slow-computer
    stage: matching
    when:
      - {fact: task, field: profile, op: eq, value: balanced}
    then:
      - {choose: matching.block_match, score: 0.99}
    because: This rig has a slow computer.
    references: [the data sheet of the rig]
"""


@pytest.fixture
def rig(tmp_path) -> Path:
    path = tmp_path / "rig.yaml"
    path.write_text(RIG)
    return path


@pytest.fixture
def watched(rig) -> Watch:
    watch = Watch(shifted_pair(), lambda: ExpertSystem(rules=[rig], engine="compiled"))
    assert watch.look() == ()
    return watch


def test_a_save_tells_what_changed_in_the_rules_and_in_the_decision(watched, rig):
    rig.write_text(RIG.replace("value: balanced", "value: fast"))
    lines = watched.look()
    assert lines[0] == (
        "changed  rule MAT900, condition: the profile of task is balanced -> the profile of task is fast"
    )
    assert "rules that fire no longer: MAT900" in lines
    assert any(line.startswith("matching.matcher: matching.block_match (MAT900) -> ") for line in lines)
    assert "this does not hold: the profile of task is fast (measured balanced)" in lines[-1]


def test_nothing_is_measured_twice_and_what_is_asked_for_first_is_said(rig, monkeypatch):
    counts: dict[str, int] = {}

    def counting(probe):
        def function(subject):
            counts[probe.name] = counts.get(probe.name, 0) + 1
            return probe.function(subject)

        return replace(probe, function=function)

    counted = {name: counting(probe) for name, probe in probes().items()}
    monkeypatch.setattr("expert.api.probes", lambda: counted)
    watch = Watch(shifted_pair(), lambda: ExpertSystem(rules=[rig], profile="fast", engine="compiled"))
    watch.look()
    first = dict(counts)
    rig.write_text(RIG.replace("0.99", "0.98"))
    watch.look()
    assert counts == first
    assert set(first.values()) == {1}
    rule = RIG.replace("MAT900", "MEA900").replace("matching", "measurement").replace("balanced", "fast")
    rig.write_text(rule.replace("{choose: measurement.block_match, score: 0.99}", "{measure: measurement.vignetting}"))
    assert "measured for the first time: measurement.vignetting" in watch.look()


def test_a_wrong_file_is_told_and_the_last_decision_stays(watched, rig):
    before = watched.decision
    rig.write_text(RIG.replace("value: balanced", "value: balanced2"))
    (line,) = watched.look()
    assert line.startswith(f"{rig}:7:53: out-of-range: rule MAT900, condition 1")
    assert watched.decision is before
    rig.write_text(RIG.replace("a slow", "a very slow"))
    assert watched.look()[1:] == ("the decision about this pair stays",)


def test_each_save_is_followed_by_one_look(rig, capsys):
    looks = []
    saves = iter([RIG + "# once\n", None, RIG + "# and again\n"])

    def wait():
        text = next(saves)
        if text is not None:
            rig.write_text(text)

    follow(lambda: looks.append(stamp([rig])) or ("looked",), [rig], 2, wait)
    assert len(looks) == 2
    assert capsys.readouterr().out.count("\n  looked") == 2


def test_a_file_that_is_being_replaced_is_waited_for(rig, capsys):
    steps = iter([rig.unlink, lambda: rig.write_text(RIG + "# new\n")])
    follow(lambda: ("looked",), [rig], 2, lambda: next(steps)())
    assert capsys.readouterr().out.count("looked") == 1
