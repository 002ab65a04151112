from __future__ import annotations

import copy
import json
from pathlib import Path

import jsonschema
import pytest
import yaml

import knowledge
from expert.facts import vocabulary
from expert.rules.schema import json_schema
from modules.catalog import operators, probes

FOLDER = Path(knowledge.__path__[0])
PUBLISHED = FOLDER / "rules.schema.json"
RULES = FOLDER / "rules.yaml"


@pytest.fixture(scope="module")
def schema():
    return json.loads(PUBLISHED.read_text(encoding="utf-8"))


def test_the_published_schema_is_up_to_date(schema):
    current = json_schema(vocabulary(probes().values()), operators(), probes())
    assert schema == current, "write it anew: terrex rules schema > knowledge/rules.schema.json"


def test_the_shipped_rules_name_the_schema_and_satisfy_it(schema):
    text = RULES.read_text(encoding="utf-8")
    assert text.startswith(f"# yaml-language-server: $schema=./{PUBLISHED.name}\n")
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.Draft202012Validator(schema).validate(yaml.safe_load(text))


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("when", 0, "fact"), "tusk"),
        (("when", 0, "field"), "range_gven"),
        (("when", 0, "op"), "equals"),
        (("then", 0), {"measure": "measurement.nothing"}),
        (("stage",), "measuring"),
        (("when", 0), {"fact": "task", "field": "profile", "op": "eq", "value": "faast"}),
        (("when", 0), {"fact": "noise", "field": "left_sigma_dn", "op": "gt", "value": 3, "unit": "px"}),
        (("then", 0), {"choose": "correction.match_histograms", "with": {"chanels": "each"}}),
        (("then", 0), {"choose": "correction.match_histograms", "with": {"channels": "every"}}),
        (("then", 0), {"set": "matching.semi_global_match", "parameter": "windw_px", "to": 9}),
        (("then", 0), {"repair": "matching.remove_speckles", "with": {"max_size_px": -5}}),
    ],
)
def test_a_wrong_word_does_not_satisfy_the_schema(schema, path, value):
    data = yaml.safe_load(RULES.read_text(encoding="utf-8"))
    rule = next(copy.deepcopy(rule) for rule in data["rules"] if rule["id"] == "MEA001")
    known = jsonschema.Draft202012Validator(schema)
    known.validate({"version": 1, "rules": [rule]})
    *parents, last = path
    place = rule
    for key in parents:
        place = place[key]
    place[last] = value
    with pytest.raises(jsonschema.ValidationError):
        known.validate({"version": 1, "rules": [rule]})


@pytest.mark.parametrize(
    "action",
    [
        {"choose": "correction.match_histograms", "with": {"channels": "each"}, "score": 0.5},
        {"choose": "none", "slot": "matcher"},
        {"set": "matching.semi_global_match", "parameter": "window_px", "to": {"round": {"value": 9, "unit": "px"}}},
        {"repair": "matching.use_range", "with": {"max_px": {"mul": [2, {"field": "r.max_px"}]}}},
    ],
)
def test_operators_with_their_own_parameters_satisfy_the_schema(schema, action):
    data = yaml.safe_load(RULES.read_text(encoding="utf-8"))
    rule = next(copy.deepcopy(rule) for rule in data["rules"] if rule["id"] == "MEA001")
    rule["then"] = [action]
    jsonschema.Draft202012Validator(schema).validate({"version": 1, "rules": [rule]})


def test_every_field_and_parameter_has_a_hover_text(schema):
    branches = [branch["then"]["properties"] for branch in schema["$defs"]["Comparison"]["allOf"]]
    listed = [item for branch in branches for item in branch.get("field", {}).get("oneOf", [])]
    texts = {item["const"]: item["description"] for item in listed if "const" in item}
    assert texts["mean_difference_dn"].endswith("[dn], -255 to 255")
    for operator in operators().values():
        shown = schema["$defs"][f"parameters of {operator.name}"]["properties"]
        assert set(shown) == set(operator.params.model_fields)
        assert all("; default " in item["description"] for item in shown.values())
