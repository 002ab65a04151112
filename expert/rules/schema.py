"""JSON Schema of the rule file, with the names that rules may use, for editors that complete and check YAML."""

from __future__ import annotations

import copy
import math
import typing
from collections.abc import Iterable, Mapping
from typing import Any, TypeAlias
from urllib.parse import quote

from expert.facts import FieldInfo, Vocabulary
from expert.rules.checks.parameters import limits_of
from expert.rules.explain import OP_WORDS
from expert.rules.model import RuleBase
from modules.operator import Operator
from modules.probe import Probe

Json: TypeAlias = dict[str, Any]
_OPERAND: Json = {"$ref": "#/$defs/Operand"}


def _named(pairs: Iterable[tuple[str, str]]) -> Json:
    """Return a schema of names, each with the text that editors show beside it."""
    return {"oneOf": [{"const": name, "description": text} for name, text in pairs]}


def _when(conditions: Mapping[str, str], then: Json) -> Json:
    """Return a branch that holds where keys have given values."""
    properties = {key: {"const": value} for key, value in conditions.items()}
    return {"if": {"properties": properties, "required": list(conditions)}, "then": {"properties": then}}


def _definition(name: str) -> Json:
    return {"$ref": f"#/$defs/{quote(name)}"}


def _field_text(field: FieldInfo) -> str:
    text = f"{field.description} [{field.unit}]"
    if field.ge is not None or field.le is not None:
        low, high = ("" if end is None else f"{end:g}" for end in (field.ge, field.le))
        text += f", {low} to {high}"
    return text


def _fact_branches(vocabulary: Vocabulary) -> list[Json]:
    """For each template: which fields a comparison may name; for each field: its unit, and its values if few."""
    branches: list[Json] = []
    for name, template in sorted(vocabulary.items()):
        fields = _named((field.name, _field_text(field)) for field in template.fields.values())
        branches.append(_when({"fact": name}, {"field": {"oneOf": [*fields["oneOf"], {"type": "null"}]}}))
        for field in template.fields.values():
            then: Json = {} if field.unit == "1" else {"unit": {"enum": [field.unit, None]}}
            if field.choices:
                one = {"enum": list(field.choices)}
                then["value"] = {"anyOf": [one, {"type": "array", "items": one}, _OPERAND, {"type": "null"}]}
            if then:
                branches.append(_when({"fact": name, "field": field.name}, then))
    return branches


def _parameter(operator: Operator, name: str) -> Json:
    """Return what one parameter may be: its literal values, or an operand."""
    info = operator.params.model_fields[name]
    low, high = limits_of(operator.params, name)
    limits = "" if math.isinf(low) and math.isinf(high) else f" [{low:g} to {high:g}]"
    literal: Json = {"type": ["boolean", "number", "string"]}
    if typing.get_origin(info.annotation) is typing.Literal:
        literal = {"enum": list(typing.get_args(info.annotation))}
    elif info.annotation in (int, float):
        literal = {"type": "integer" if info.annotation is int else "number"}
        literal.update({key: end for key, end in (("minimum", low), ("maximum", high)) if math.isfinite(end)})
    elif info.annotation is bool:
        literal = {"type": "boolean"}
    text = f"{info.description or name}{limits}; default {info.default}"
    return {"description": text, "anyOf": [literal, _OPERAND]}


def _operator_branches(definitions: Json, operators: Mapping[str, Operator]) -> None:
    """Name the operators where one may stand, and for each its parameters."""
    names = _named((name, f"{item.summary} {item.suits}".strip()) for name, item in sorted(operators.items()))["oneOf"]
    nothing = {"const": "none", "description": "Leave the slot empty"}
    for model, key in (("Choose", "choose"), ("Repair", "repair"), ("Slot", "default")):
        definitions[model]["properties"][key] = {"oneOf": [*names, nothing]}
    definitions["Slot"]["properties"]["default"]["default"] = "none"
    for model, key in (("Exclude", "exclude"), ("Set", "set"), ("Adjust", "adjust")):
        definitions[model]["properties"][key] = {"oneOf": names}
    for name, operator in sorted(operators.items()):
        parameters = {parameter: _parameter(operator, parameter) for parameter in operator.params.model_fields}
        given, listed = f"parameters of {name}", f"names of the parameters of {name}"
        definitions[given] = {"type": "object", "properties": parameters, "additionalProperties": False}
        definitions[listed] = _named((parameter, item["description"]) for parameter, item in parameters.items())
        if not parameters:
            definitions[listed] = {"not": {}}
        for place, key, what in (
            ("Choose", "choose", given),
            ("Repair", "repair", given),
            ("Slot", "default", given),
            ("Set", "set", listed),
            ("Adjust", "adjust", listed),
        ):
            then = {"with" if what is given else "parameter": _definition(what)}
            definitions[place].setdefault("allOf", []).append(_when({key: name}, then))


def json_schema(vocabulary: Vocabulary, operators: Mapping[str, Operator], probes: Mapping[str, Probe]) -> Json:
    """Return the schema of a rule file.

    Facts, their fields, operators, their parameters and probes are spelled out with their descriptions, units and
    ranges; which fields and parameters may stand in a place depends on the fact and the operator beside them.
    """
    schema = copy.deepcopy(RuleBase.model_json_schema(by_alias=True))
    definitions: Json = schema["$defs"]
    kinds = ("FieldRef", "ThresholdRef", "Quantity", "Calculation")
    definitions["Operand"] = {"anyOf": [_definition(kind) for kind in kinds]}
    comparison = definitions["Comparison"]
    comparison["properties"]["fact"] = _named((name, item.description) for name, item in sorted(vocabulary.items()))
    comparison["properties"]["op"] = {
        **_named((name, text.format("the value")) for name, text in OP_WORDS.items()),
        "default": "present",
    }
    comparison["allOf"] = _fact_branches(vocabulary)
    if operators:
        _operator_branches(definitions, operators)
    if probes:
        definitions["Measure"]["properties"]["measure"] = _named(
            (name, item.summary) for name, item in sorted(probes.items())
        )
        cheap = {name: item for name, item in sorted(probes.items()) if (item.tier, item.subject) == ("cheap", "pair")}
        known = definitions["Exclude"]["properties"]["exclude"].get("oneOf", [])
        left_out = _named((name, item.summary) for name, item in cheap.items())["oneOf"]
        definitions["Exclude"]["properties"]["exclude"] = {"oneOf": [*known, *left_out]}
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "terrex rule file"
    return schema
