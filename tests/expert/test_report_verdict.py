"""The verdict: three sentences from the record, and nothing that is not in it."""

from __future__ import annotations

import pytest

from expert.decision import Decision, FactRecord, FindingRecord, TrialRecord
from expert.plan import StagePlan, Step
from expert.report import as_markdown, as_summary, as_text, verdict


def step(slot: str, operator: str, **parameters: object) -> Step:
    return Step(
        slot=slot, operator=operator, parameters=parameters, chosen_by="R1", set_by=dict.fromkeys(parameters, "R1")
    )


def finding(name: str, severity: str, sentence: str, stage: str = "measurement") -> FindingRecord:
    return FindingRecord(name=name, severity=severity, sentence=sentence, rules=("R1",), stage=stage)


def record(**changes: object) -> Decision:
    matching = StagePlan(
        stage="matching",
        steps=(
            step("range", "matching.use_range", min_px=3, max_px=64),
            step("matcher", "matching.semi_global_block_match"),
        ),
    )
    values: dict[str, object] = {
        "pair": "p",
        "status": "reconstructed",
        "profile": "balanced",
        "rules_digest": "0" * 64,
        "inputs": {side: {"sha256": "1" * 64, "shape": (2, 3), "dtype": "uint8"} for side in ("left", "right")},
        "facts": (
            FactRecord(template="disparity_quality", fields={"density_fraction": 0.91, "confidence_mean": 0.966}),
            FactRecord(template="terrain_quality", fields={"covered_m2": 240.04, "median_sigma_m": 0.0074}),
        ),
        "firings": (),
        "findings": (),
        "plans": {
            "correction": StagePlan(stage="correction", steps=(step("denoise", "correction.denoise_gaussian"),)),
            "matching": matching,
        },
    }
    return Decision.model_validate({**values, **changes})


def test_a_sound_pair_has_nothing_wrong_and_its_products_are_trusted() -> None:
    told = verdict(record())
    assert told.wrong == "Nothing was found wrong with the pair."
    assert told.done == (
        "The pair was reconstructed to terrain: corrected by denoise_gaussian (smooths both images with a Gaussian); "
        "matched by semi_global_block_match (match blocks with a smoothness penalty along several paths) "
        "from 3 to 64 px."
    )
    assert told.trust == (
        "Trust the disparity of 91 % of the pixels (97 % of these are likely right within 1 px) and the heights of "
        "240.0 m2 of ground to 0.7 cm (1 sigma, median)."
    )


def test_grave_findings_of_the_pair_are_told_and_minor_ones_only_where_there_is_nothing_else() -> None:
    grave = finding("a", "major", "rows differ; the rectification is off")
    other = finding("b", "critical", "the images are swapped")
    minor = finding("c", "minor", "no calibration was given")
    assert verdict(record(findings=(other, grave, minor))).wrong == (
        "Wrong with the pair: the images are swapped and rows differ (the rectification is off)."
    )
    assert verdict(record(findings=(minor,))).wrong == (
        "Nothing grave was wrong with the pair, only this was noted: no calibration was given."
    )


def test_findings_about_the_products_limit_the_trust_and_are_not_told_of_the_pair() -> None:
    walls = finding("walls", "minor", "many cells hold walls; distrust their height", "reconstruction")
    told = verdict(record(findings=(walls,)))
    assert told.wrong == "Nothing was found wrong with the pair."
    assert told.trust.endswith("(1 sigma, median); but many cells hold walls (distrust their height).")


def test_a_grave_finding_about_the_products_asks_for_care() -> None:
    doubtful = finding("doubtful", "major", "many of the matched pixels are probably wrong", "matching")
    assert verdict(record(findings=(doubtful,))).trust.startswith("Trust only with care the disparity of 91 %")


def test_no_more_than_four_things_are_named() -> None:
    five = tuple(finding(name, "major", f"wrong {name}") for name in "abcde")
    assert verdict(record(findings=five[:4])).wrong == "Wrong with the pair: wrong a, wrong b, wrong c and wrong d."
    assert verdict(record(findings=five)).wrong == "Wrong with the pair: wrong a, wrong b, wrong c and 2 more things."


def test_several_trials_are_told_with_the_one_that_was_kept() -> None:
    plan = StagePlan(stage="matching", steps=())
    trials = tuple(TrialRecord(stage="matching", number=number, plan=plan, kept=number == 2) for number in (1, 2, 3))
    assert "of 3 trials of matching, number 2 was kept." in verdict(record(trials=trials)).done


@pytest.mark.parametrize(
    ("status", "done", "trust"),
    [
        ("failed", "The pair could not be reconstructed: the images are unrelated.", "Trust none of its products."),
        ("decided", "A plan was made and nothing was run yet: corrected by", "There is nothing to trust yet."),
        ("disparity_only", "The disparity was computed, but no terrain: corrected by", "Trust the disparity of 91 %"),
    ],
)
def test_the_sentences_follow_the_status(status: str, done: str, trust: str) -> None:
    told = verdict(record(status=status, findings=(finding("a", "critical", "the images are unrelated"),)))
    assert told.done.startswith(done)
    assert told.trust.startswith(trust)


def test_every_rendering_begins_with_the_three_sentences() -> None:
    decision = record()
    told = verdict(decision)
    assert as_text(decision).startswith(f"p: {told.wrong} {told.done} {told.trust}\n")
    assert as_summary(decision).splitlines()[1:4] == [f"  {told.wrong}", f"  {told.done}", f"  {told.trust}"]
    head = as_markdown(decision).replace("\\", "").split("\n\n")[1].splitlines()
    assert head == [f"- {told.wrong}", f"- {told.done}", f"- {told.trust}"]


@pytest.mark.parametrize(
    ("severities", "status", "grade"),
    [
        ((), "reconstructed", "good"),
        (("minor",), "reconstructed", "good"),
        (("minor", "major"), "reconstructed", "care"),
        (("major", "critical"), "reconstructed", "bad"),
        ((), "failed", "bad"),
    ],
)
def test_the_grade_is_that_of_the_worst_finding(severities: tuple[str, ...], status: str, grade: str) -> None:
    found = tuple(finding(f"f{number}", severity, "something") for number, severity in enumerate(severities))
    assert verdict(record(findings=found, status=status)).grade == grade


def test_what_masks_exclude_is_not_counted_as_there() -> None:
    quality = {"density_fraction": 0.98, "usable_fraction": 0.75, "confidence_mean": 0.997}
    told = verdict(record(facts=(FactRecord(template="disparity_quality", fields=quality),)))
    assert told.trust == (
        "Trust the disparity of 74 % of the pixels (over 99 % of these are likely right within 1 px; "
        "masks exclude 25 %)."
    )
