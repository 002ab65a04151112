from __future__ import annotations

import pytest
import yaml

from expert.rules.explain import condition_text, sentence
from expert.rules.model import AnyOf, Not
from expert.rules.schema import json_schema


def test_a_rule_reads_as_a_sentence_with_units(load, good_text, words):
    base = load(good_text).base
    assert sentence(base.rules[0], words, base.thresholds) == (
        "In correction, when the offset_dn of brightness is at least the threshold large_offset (6 dn) in magnitude: "
        "note the major finding exposure-differs, because costs that use raw intensity read it as mismatch."
    )
    assert sentence(base.rules[1]) == (
        "In correction, when there is the finding exposure-differs (major or worse) and there is a fact brightness and "
        "it is not so that the clipped_fraction of brightness is above 0.05: choose correction.match_histograms with "
        "channels gray, strength clamp((the offset_dn of brightness / 100), 0, 1) (score 0.8), "
        "because one lookup table removes the difference."
    )


def test_nested_conditions_are_written_in_full():
    inner = {"fact": "side", "as": "l", "field": "mean_dn", "op": "between", "value": [10, 20]}
    assert condition_text(AnyOf.model_validate({"any_of": [inner, {"finding": "x"}]})) == (
        "either the mean_dn of side (called l) is between 10 dn and 20 dn or there is the finding x"
    )
    assert condition_text(Not.model_validate({"not": inner})).startswith("it is not so that the mean_dn")


def test_the_schema_accepts_the_sound_file_and_knows_the_fields(good_text, words, operators, probes):
    jsonschema = pytest.importorskip("jsonschema")
    schema = json_schema(words, operators, probes)
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)
    assert validator.is_valid(yaml.safe_load(good_text))
    assert not validator.is_valid(yaml.safe_load(good_text.replace("offset_dn, op", "ofset_dn, op")))
    assert not validator.is_valid(yaml.safe_load(good_text.replace("choose: correction.m", "choose: correction.n")))
