"""JSON Schema of the rule file, with the names that rules may use, for editors that complete and check YAML."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any, TypeAlias

from expert.facts import Vocabulary
from expert.rules.model import RuleBase
from modules.operator import Operator
from modules.probe import Probe

Json: TypeAlias = dict[str, Any]


def _field_branches(vocabulary: Vocabulary) -> list[Json]:
    """For each template: which fields a comparison may name."""
    branches: list[Json] = []
    for name, template in sorted(vocabulary.items()):
        fields = [
            {"const": field.name, "description": f"{field.description} [{field.unit}]"}
            for field in template.fields.values()
        ]
        branches.append(
            {
                "if": {"properties": {"fact": {"const": name}}, "required": ["fact"]},
                "then": {"properties": {"field": {"oneOf": [*fields, {"type": "null"}]}}},
            }
        )
    return branches


def _name_operators(definitions: Json, operators: Mapping[str, Operator]) -> None:
    names = [{"const": name, "description": item.summary} for name, item in sorted(operators.items())]
    nothing = {"const": "none", "description": "Leave the slot empty"}
    for model, key in (("Choose", "choose"), ("Repair", "repair")):
        definitions[model]["properties"][key] = {"oneOf": [*names, nothing]}
    for model, key in (("Exclude", "exclude"), ("Set", "set"), ("Adjust", "adjust")):
        definitions[model]["properties"][key] = {"oneOf": names}
    definitions["Slot"]["properties"]["default"] = {"oneOf": [*names, nothing], "default": "none"}


def json_schema(vocabulary: Vocabulary, operators: Mapping[str, Operator], probes: Mapping[str, Probe]) -> Json:
    """Return the schema of a rule file.

    Facts, their fields, operators and probes are spelled out with their descriptions and units.
    """
    schema = copy.deepcopy(RuleBase.model_json_schema(by_alias=True))
    definitions: Json = schema["$defs"]
    facts = [{"const": name, "description": item.description} for name, item in sorted(vocabulary.items())]
    definitions["Comparison"]["properties"]["fact"] = {"oneOf": facts}
    definitions["Comparison"]["allOf"] = _field_branches(vocabulary)
    if operators:
        _name_operators(definitions, operators)
    if probes:
        listed = [{"const": name, "description": item.summary} for name, item in sorted(probes.items())]
        definitions["Measure"]["properties"]["measure"] = {"oneOf": listed}
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "terrex rule file"
    return schema
