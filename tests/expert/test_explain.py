from __future__ import annotations

import json

import pytest
from synthetic_pairs import shifted_pair

from expert.decision import Decision
from expert.engine import make_engine
from expert.explain import ExplainError, how, not_chosen, what_if, what_would_it_take, why_not
from expert.facts import Fact, vocabulary
from expert.knowledge import Knowledge
from expert.recorder import inputs_record
from expert.rules.load import load_rules
from expert.supervise import Run
from modules.catalog import operators, probes

RULES = """version: 1
findings: {exposure-differs: the images differ in exposure}
slots:
  correction:
    - {slot: denoise, default: none, because: smoothing costs detail}
    - {slot: radiometry, default: none, because: nothing}
  matching:
    - {slot: matcher, default: matching.semi_global_block_match, because: fast}
rules:
  - id: MEA901
    name: exposure-differs
    stage: measurement
    when: [{fact: brightness, field: mean_difference_dn, op: abs_ge, value: 6.0}]
    then: [{derive: exposure-differs, severity: major}]
    because: The means of the two images differ.
    references: [none]
  - id: COR901
    name: exposure-differs-globally
    stage: correction
    when: [{finding: exposure-differs}, {fact: saturation, field: difference_fraction, op: lt, value: 0.2}]
    then: [{choose: correction.match_histograms, score: 0.8}]
    because: One map removes the difference.
    references: [none]
  - id: COR902
    name: exposure-differs-linearly
    stage: correction
    when: [{finding: exposure-differs}, {fact: task, field: profile, op: eq, value: balanced}]
    then: [{choose: correction.fit_gain_offset, score: 0.6}]
    because: A line removes the difference.
    references: [none]
  - id: COR903
    name: noisy-on-both-sides
    stage: correction
    when:
      - {fact: noise, field: left_sigma_dn, op: ge, value: 5.0}
      - {fact: noise, field: right_sigma_dn, op: ge, value: 5.0}
    then: [{choose: correction.denoise_gaussian, score: 0.7}]
    because: Noise on both sides hides the texture.
    references: [none]
  - id: MAT901
    name: accuracy-asked-for
    stage: matching
    when: [{fact: task, field: profile, op: eq, value: balanced}]
    then: [{choose: matching.semi_global_match, score: 0.8}]
    because: It is the most accurate matcher.
    references: [none]
  - id: MAT902
    name: time-is-tiny
    stage: matching
    when: [{fact: task, field: time_budget_s, op: lt, value: 0.5}]
    then: [{choose: matching.block_match, score: 0.95}]
    because: It is the fastest matcher.
    references: [none]
  - id: MAT903
    name: exposure-forbids-raw-costs
    stage: matching
    when: [{finding: exposure-differs, at_least: major}]
    then: [{exclude: matching.semi_global_block_match}]
    because: Raw costs read a difference as mismatch.
    references: [none]
"""
INPUTS = inputs_record(shifted_pair())
PAIR = {
    Fact.of("task", profile="balanced", range_given=False): None,
    Fact.of("brightness", mean_difference_dn=9.0, channel_spread_dn=1.0): "measurement.brightness",
    Fact.of("saturation", difference_fraction=0.01): "measurement.saturation",
    Fact.of("noise", left_sigma_dn=1.0, right_sigma_dn=2.0): "measurement.noise",
}


@pytest.fixture(scope="module")
def rules(tmp_path_factory):
    path = tmp_path_factory.mktemp("rules") / "rig.yaml"
    path.write_text(RULES)
    return load_rules([path], vocabulary(probes().values()), operators(), probes(), shipped=False)


@pytest.fixture(scope="module")
def engine():
    return make_engine("compiled", vocabulary(probes().values()))


@pytest.fixture(scope="module")
def decision(rules, engine):
    return decide(rules, engine)


def decide(rules, engine, facts=PAIR):
    """Decide on given facts and read the record back from its text."""
    run = Run(Knowledge(rules, engine, operators(), probes()), None, dict(facts))
    run.concluded["measurement"] = run.infer("measurement")
    for stage in ("correction", "matching"):
        run.plan(stage)
    made = Decision(
        pair="hand made",
        status="decided",
        profile="balanced",
        rules_digest=rules.digest,
        inputs=INPUTS,
        facts=run.fact_records(),
        firings=run.firing_records(),
        findings=run.findings(),
        plans={plan.stage: plan for plan in run.plans.values()},
    )
    return Decision.from_json(made.to_json())


def test_a_record_read_back_is_the_same(decision):
    assert Decision.from_json(decision.to_json()) == decision


def test_a_record_that_was_edited_is_refused(decision):
    data = json.loads(decision.to_json())
    data["status"] = "failed"
    with pytest.raises(ValueError, match="changed after it was written"):
        Decision.from_json(json.dumps(data))


def test_a_text_that_is_no_record_is_refused():
    with pytest.raises(ValueError, match="there is no decision_id"):
        Decision.from_json("{}")


def test_how_tells_rule_condition_fact_unit_probe_and_the_finding_below(decision, rules):
    text = how(decision, "correction.radiometry", rules).text()
    assert "correction.radiometry: correction.match_histograms" in text
    assert "COR901 exposure-differs-globally" in text
    assert ") fired: One map removes the difference" in text
    assert "major finding exposure-differs: the images differ in exposure" in text
    assert "mean_difference_dn of brightness is at least 6 dn in magnitude" in text
    assert "in magnitude: 9 dn, 3 dn beyond the limit (measured by measurement.brightness)" in text
    assert "rather than correction.fit_gain_offset (COR902, score 0.6): score 0.6 is below 0.8" in text


def test_how_tells_that_nothing_to_do_is_the_default(decision, rules):
    assert "it is the default of the slot; no rule chose another" in how(decision, "denoise", rules).text()


def test_how_also_answers_without_rules(decision):
    assert "MAT901 accuracy-asked-for fired" in how(decision, "matching").text()


def test_how_suggests_the_nearest_name(decision, rules):
    with pytest.raises(ExplainError, match=r"did you mean 'matching\.matcher'"):
        how(decision, "matching.macher", rules)


def test_why_not_of_a_loser_names_the_winner_and_both_scores(decision, rules):
    answer = why_not(decision, rules, "correction.fit_gain_offset")
    assert answer.outcome == "lost"
    assert "score 0.6 is below 0.8 of correction.match_histograms (COR901)" in answer.text()


def test_why_not_of_an_unfired_rule_gives_value_limit_unit_and_margin(decision, rules):
    answer = why_not(decision, rules, "COR903")
    verdict = answer.rules[0]
    assert (answer.outcome, verdict.value, verdict.limit, verdict.unit, verdict.margin) == (
        "conditions",
        1.0,
        5.0,
        "dn",
        4.0,
    )
    assert "(measured 1 dn, limit 5 dn, short by 4 dn)" in answer.text()


def test_why_not_of_an_operator_names_the_rules_that_would_choose_it(decision, rules):
    answer = why_not(decision, rules, "matching.block_match")
    assert answer.outcome == "conditions"
    assert [rule.rule for rule in answer.rules] == ["MAT902"]
    assert "time_budget_s of task is below 0.5 s, which is not known" in answer.text()


def test_why_not_says_what_kept_a_finding_away(rules, engine):
    facts = {fact: probe for fact, probe in PAIR.items() if fact.template != "brightness"}
    facts[Fact.of("brightness", mean_difference_dn=4.0)] = "measurement.brightness"
    answer = why_not(decide(rules, engine, facts), rules, "correction.match_histograms")
    assert [below.rule for below in answer.rules[0].below] == ["MEA901"]
    assert "(measured 4 dn, limit 6 dn, short by 2 dn)" in answer.text()


def test_why_not_tells_an_exclusion_and_its_rule(decision, rules):
    answer = why_not(decision, rules, "matching.semi_global_block_match")
    assert answer.outcome == "excluded"
    assert "MAT903 exposure-forbids-raw-costs: Raw costs read a difference as mismatch" in answer.text()


def test_why_not_tells_that_no_rule_ever_chooses_an_operator(decision, rules):
    assert why_not(decision, rules, "correction.normalise_local_contrast").outcome == "never"


def test_why_not_of_what_was_chosen_or_fired_says_so(decision, rules):
    assert why_not(decision, rules, "matching.semi_global_match").outcome == "chosen"
    assert "correction.fit_gain_offset lost correction.radiometry" in why_not(decision, rules, "COR902").text()


def test_why_not_of_a_stage_that_was_never_reached(decision, rules):
    assert why_not(decision, rules, "reconstruction.gate_points").outcome == "not_reached"


def test_what_if_says_which_steps_and_findings_change(decision, rules, engine):
    answer = what_if(decision, rules, engine, {"brightness.mean_difference_dn": 0.0})
    assert [(step.slot, step.after) for step in answer.steps] == [("correction.radiometry", "none")]
    assert answer.findings_gone == ("exposure-differs (major)",)
    assert answer.text().startswith("If brightness.mean_difference_dn: 9 dn -> 0 dn:\n")


def test_what_if_with_the_recorded_value_changes_nothing(decision, rules, engine):
    answer = what_if(decision, rules, engine, {"brightness.mean_difference_dn": 9.0})
    assert (answer.steps, answer.findings_gone, answer.fired_instead) == ((), (), ())


@pytest.mark.parametrize(
    ("target", "value", "message"),
    [
        ("brightnes.mean_difference_dn", 1.0, "did you mean 'brightness'"),
        ("brightness.mean_diference_dn", 1.0, "did you mean 'mean_difference_dn'"),
        ("task.profile", "slow", "is one of fast, balanced, best"),
        ("noise.left_sigma_dn", "much", "is a number in dn"),
        ("noise", 1.0, r"is not FACT\.FIELD"),
    ],
)
def test_what_if_refuses_what_no_fact_can_be(decision, rules, engine, target, value, message):
    with pytest.raises(ExplainError, match=message):
        what_if(decision, rules, engine, {target: value})


def test_it_takes_one_field_at_its_limit_to_flip_a_choice(decision, rules, engine):
    answer = what_would_it_take(decision, rules, engine, "correction.fit_gain_offset")
    (change,) = answer.ways[0].changes
    assert (change.fact, change.field, change.after, answer.ways[0].chosen_by) == (
        "saturation",
        "difference_fraction",
        0.2,
        "COR902",
    )


def test_it_takes_two_fields_where_one_is_not_enough(decision, rules, engine):
    answer = what_would_it_take(decision, rules, engine, "correction.denoise_gaussian")
    assert sorted((change.field, change.after) for change in answer.ways[0].changes) == [
        ("left_sigma_dn", 5.0),
        ("right_sigma_dn", 5.0),
    ]


def test_what_it_takes_really_flips_the_choice(decision, rules, engine):
    for operator in ("matching.block_match", "correction.denoise_gaussian", "correction.radiometry=none"):
        answer = what_would_it_take(decision, rules, engine, operator)
        for way in answer.ways:
            assumed = {f"{change.fact}.{change.field}": change.after for change in way.changes}
            steps = what_if(decision, rules, engine, assumed).steps
            assert (answer.slot, answer.operator) in [(step.slot, step.after) for step in steps]


def test_what_is_chosen_already_takes_nothing(decision, rules, engine):
    assert what_would_it_take(decision, rules, engine, "matching.semi_global_match").already


def test_that_no_change_of_two_fields_is_enough_is_stated(rules, engine):
    facts = dict(PAIR)
    del facts[Fact.of("noise", left_sigma_dn=1.0, right_sigma_dn=2.0)]
    answer = what_would_it_take(decide(rules, engine, facts), rules, engine, "correction.denoise_gaussian")
    assert (answer.ways, answer.complete) == ((), True)
    assert answer.text().startswith("No change of one or two fields gives correction.denoise_gaussian instead of none")


def test_other_rules_than_those_of_the_record_are_refused(decision, rules):
    other = decision.model_copy(update={"rules_digest": "0" * 64})
    with pytest.raises(ExplainError, match="give the rule files of that run with --rules"):
        why_not(other, rules, "COR901")


def test_that_no_rule_ever_gives_an_operator_is_stated(decision, rules, engine):
    answer = what_would_it_take(decision, rules, engine, "matching.matcher=none")
    assert "no rule ever chooses it, and it is not the default" in answer.text()


def test_every_operator_without_a_slot_is_answered_like_a_single_question(decision, rules):
    answers = not_chosen(decision, rules)
    chosen = {step.operator for step in decision.steps()}
    assert [answer.name for answer in answers] == sorted(set(operators()) - chosen)
    assert answers[0] == why_not(decision, rules, answers[0].name)
