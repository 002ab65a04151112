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
    jsonschema.validate(yaml.safe_load(text), schema)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("when", 0, "fact"), "tusk"),
        (("when", 0, "field"), "range_gven"),
        (("when", 0, "op"), "equals"),
        (("then", 0), {"measure": "measurement.nothing"}),
        (("stage",), "measuring"),
    ],
)
def test_a_wrong_word_does_not_satisfy_the_schema(schema, path, value):
    data = yaml.safe_load(RULES.read_text(encoding="utf-8"))
    rule = next(copy.deepcopy(rule) for rule in data["rules"] if rule["id"] == "MEA001")
    jsonschema.validate({"version": 1, "rules": [rule]}, schema)
    *parents, last = path
    place = rule
    for key in parents:
        place = place[key]
    place[last] = value
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({"version": 1, "rules": [rule]}, schema)
