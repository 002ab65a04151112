"""A sequence: what the earlier decision tells, and when it tells nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic_pairs import shifted_pair

from expert import Decision, ExpertSystem, StereoPair
from expert.decision import FactRecord
from expert.warm import change_dn, previous_pair, thumbnail

SYSTEM = ExpertSystem(engine="compiled")


@pytest.fixture(scope="module")
def first() -> Decision:
    return SYSTEM.reconstruct(shifted_pair()).decision


def names(decision: Decision) -> set[str]:
    return {finding.name for finding in decision.findings}


def probes_of(decision: Decision) -> set[str]:
    return {fact.probe for fact in decision.facts if fact.probe}


def test_a_thumbnail_does_not_differ_from_itself() -> None:
    image = shifted_pair().left
    assert change_dn(thumbnail(image), thumbnail(image)) == (0.0, 0.0)


def test_a_brighter_image_changes_levels_only_and_a_mirrored_one_places_only() -> None:
    ramp = np.tile(np.linspace(20, 180, 96).astype(np.uint8), (72, 1))
    in_place, in_levels = change_dn(thumbnail(ramp), thumbnail(ramp + np.uint8(30)))
    assert (in_place, in_levels) == (pytest.approx(0.0, abs=0.5), pytest.approx(30.0, abs=0.5))
    in_place, in_levels = change_dn(thumbnail(ramp), thumbnail(np.ascontiguousarray(ramp[:, ::-1])))
    assert in_place > 50
    assert in_levels == pytest.approx(0.0, abs=0.5)


def test_a_scene_that_goes_on_is_not_measured_again_and_gives_the_same_map(first: Decision) -> None:
    cold, warm = SYSTEM.reconstruct(shifted_pair()), SYSTEM.reconstruct(shifted_pair(), previous=first)
    assert {"scene-continues", "rows-known"} <= names(warm.decision)
    measured = {"measurement.disparity_range", "measurement.row_alignment"}
    assert measured <= probes_of(cold.decision)
    assert not measured & probes_of(warm.decision)
    np.testing.assert_array_equal(warm.disparity_px, cold.disparity_px)


def test_the_state_of_a_sequence_is_what_the_caller_hands_on(first: Decision) -> None:
    SYSTEM.reconstruct(shifted_pair(), previous=first)
    assert "scene-continues" not in names(SYSTEM.reconstruct(shifted_pair()).decision)
    third = SYSTEM.decide(shifted_pair(), previous=SYSTEM.reconstruct(shifted_pair(), previous=first).decision)
    assert "rows-known" in names(third)


def test_a_decision_that_was_read_back_tells_the_same(first: Decision) -> None:
    again = Decision.from_json(first.to_json())
    assert previous_pair(again, shifted_pair()) == previous_pair(first, shifted_pair())


def test_another_scene_another_size_or_a_failure_tell_nothing(first: Decision) -> None:
    other = 255 - shifted_pair().left
    assert "scene-continues" not in names(SYSTEM.decide(StereoPair(other, other), previous=first))
    pair = shifted_pair()
    smaller = StereoPair(pair.left[:-8].copy(), pair.right[:-8].copy())
    known = previous_pair(first, smaller)
    assert known is not None
    assert not known.same_rig
    assert previous_pair(first.model_copy(update={"status": "failed"}), pair) is None
    assert previous_pair(first.model_copy(update={"thumbnail": ""}), pair) is None


def with_facts(decision: Decision, *added: FactRecord) -> Decision:
    kept = [fact for fact in decision.facts if fact.template not in {item.template for item in added}]
    return decision.model_copy(update={"facts": (*kept, *added)})


@pytest.mark.parametrize(("same_rig", "count", "told"), [(True, 0, 0), (True, None, 200), (False, None, None)])
def test_a_count_is_handed_on_only_by_the_same_rig_and_where_none_was_made(
    first: Decision, same_rig: bool, count: int | None, told: int | None
) -> None:
    before = FactRecord(template="previous", fields={"same_rig": same_rig, "rows_count": 200})
    rows = FactRecord(template="row_alignment", fields={} if count is None else {"count": count})
    known = previous_pair(with_facts(first, before, rows), shifted_pair())
    assert known is not None
    assert known.rows_count == told


def test_a_given_range_goes_before_the_earlier_one(first: Decision) -> None:
    pair = replace(shifted_pair(), disparity_range_px=(0, 20))
    decision = SYSTEM.decide(pair, previous=SYSTEM.decide(pair))
    assert "scene-continues" in names(decision)
    (step,) = [step for step in decision.steps() if step.operator == "matching.use_range"]
    assert (step.parameters["min_px"], step.parameters["max_px"], step.chosen_by) == (0, 20, "MAT001")


def test_a_range_that_does_not_hold_is_measured_after_all(first: Decision) -> None:
    pair = shifted_pair()
    moved = StereoPair(pair.left, np.roll(pair.right, -24, axis=1))
    cold, warm = SYSTEM.reconstruct(moved), SYSTEM.reconstruct(moved, previous=first)
    assert "measurement.disparity_range" in probes_of(warm.decision)
    dense = [float(np.isfinite(result.disparity_px).mean()) for result in (cold, warm)]
    assert dense[1] == pytest.approx(dense[0], abs=0.02)
