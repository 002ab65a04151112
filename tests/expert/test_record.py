"""The record of a decision: its schema, what it carries, and what it refuses."""

from __future__ import annotations

import base64
import gzip
import json
from pathlib import Path

import jsonschema
import pytest
from prov_json import check_prov
from synthetic_pairs import shifted_pair

from expert import ExpertSystem
from expert.decision import Decision, record_schema
from expert.explain import ExplainError, rules_of
from expert.explain.prov import as_prov
from modules.types import Attitude, Calibration

CALIBRATION = Calibration(focal_px=200.0, cx_px=80.0, cy_px=60.0, baseline_m=0.1, width_px=160, height_px=120)
SCHEMA = Path("knowledge/decision.schema.json")


@pytest.fixture(scope="module")
def decision() -> Decision:
    system = ExpertSystem(profile="fast", engine="compiled")
    pair = shifted_pair(calibration=CALIBRATION, attitude=Attitude(pitch_rad=0.1), name="plane")
    return system.reconstruct(pair).decision


def test_the_published_schema_is_current() -> None:
    assert json.loads(SCHEMA.read_text(encoding="utf-8")) == record_schema(), "run `make schema`"


def test_a_record_follows_the_published_schema(decision: Decision) -> None:
    schema = record_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    data = json.loads(decision.to_json())
    jsonschema.validate(data, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**data, "schema_version": 1}, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**data, "surprise": 1}, schema)


def test_a_record_reads_back_as_it_was(decision: Decision) -> None:
    assert Decision.from_json(decision.to_json()) == decision


def test_facts_have_units_and_probes(decision: Decision) -> None:
    noise = next(record for record in decision.facts if record.template == "noise")
    assert noise.units["left_sigma_dn"] == "dn"
    assert noise.probe == "measurement.noise"
    task = next(record for record in decision.facts if record.template == "task")
    assert task.probe is None


def test_firings_have_values_limits_and_margins(decision: Decision) -> None:
    ordered = [item for firing in decision.firings for item in firing.conditions if item.margin is not None]
    assert ordered
    for item in ordered:
        if not item.within:
            assert item.holds, item.text
        if not item.holds:
            assert item.margin <= 0, item.text
    assert all(firing.references and firing.actions for firing in decision.firings)


def test_a_record_carries_its_rules(decision: Decision) -> None:
    rules = rules_of(decision)
    shipped = ExpertSystem()._knowledge.rules
    assert rules.base.of_stage("matching") == shipped.base.of_stage("matching")
    assert (rules.digest, rules.positions) == (shipped.digest, shipped.positions)


def test_rules_that_are_not_those_of_the_decision_are_refused(decision: Decision) -> None:
    other = base64.b64encode(gzip.compress(b"{}")).decode()
    for content, said in (
        (other, "the rules in the record are not those it was decided with: "),
        ("AAAA", "the rules in the record are damaged: "),
        ("#", "the rules in the record are damaged: "),
    ):
        assert decision.rules is not None
        changed = decision.model_copy(update={"rules": decision.rules.model_copy(update={"content": content})})
        with pytest.raises(ExplainError, match=said):
            changed.how("matching")
    with pytest.raises(ExplainError, match="the record carries no rules"):
        decision.model_copy(update={"rules": None}).why_not("matching.block_match")


def test_provenance_follows_prov_json(decision: Decision) -> None:
    document = json.loads(json.dumps(as_prov(decision)))
    check_prov(document)
    products = [name for name in document["entity"] if name.startswith("terrex:product/")]
    assert len(products) == len(decision.products) == 3
    made = {item["prov:entity"]: item["prov:activity"] for item in document["wasGeneratedBy"].values()}
    assert made["terrex:product/elevation_m"].startswith("terrex:operator/reconstruction.")
    assert made["terrex:product/disparity_px"].startswith("terrex:operator/matching.")


def test_margins_name_every_field_once_nearest_first(decision: Decision) -> None:
    found = decision.margins()
    shares = [item.share for item in found.fields]
    assert shares == sorted(shares)
    places = [(item.fact, item.field, item.value) for item in found.fields]
    assert len(places) == len(set(places))
    fired = {rule.rule for item in found.fields for rule in item.rules if rule.fired}
    assert fired <= set(decision.rules_fired)
    assert any(not rule.fired for item in found.fields for rule in item.rules)
    for item in found.fields:
        for rule in item.rules:
            assert rule.condition.value == item.value
