"""What the loop found, as records: facts with units, firings with limits, digests of inputs and products."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from expert.decision import ActionRecord, FactRecord, FindingRecord, FiringRecord, ImageRecord, InputsRecord
from expert.facts import SEVERITIES, Fact, Vocabulary
from expert.firing import Firing, Firings
from expert.margins import MarginReader
from expert.pair import StereoPair
from expert.rules.evaluate import finding_of
from expert.rules.explain import action_text
from expert.rules.model import STAGES, Rule, RuleBase, Stage
from modules.types import Disparity, ElevationMap


def units_of(template: str, fields: Iterable[str], words: Vocabulary) -> dict[str, str]:
    """Return the units of the fields that have one."""
    known = words[template].fields if template in words else {}
    return {name: known[name].unit for name in fields if name in known and known[name].unit != "1"}


def fact_record(fact: Fact, probe: str | None, words: Vocabulary) -> FactRecord:
    """Turn a fact into its record."""
    fields = fact.as_dict()
    return FactRecord(template=fact.template, fields=fields, units=units_of(fact.template, fields, words), probe=probe)


def firing_records(
    base: RuleBase, stage: Stage, result: Firings, probe_of: Mapping[Fact, str | None], words: Vocabulary
) -> list[FiringRecord]:
    """Turn the firings of a stage into records, in canonical order.

    Parameters
    ----------
    base : RuleBase
    stage : str
    result : Firings
    probe_of : mapping of Fact to str or None
        What measured each fact.
    words : Vocabulary
        For units.
    """
    rules = base.by_id
    reader = MarginReader.over(words, base.thresholds, result.facts)
    return [
        FiringRecord(
            rule=firing.rule,
            name=rules[firing.rule].name,
            stage=stage,
            bindings={alias: fact_record(fact, probe_of.get(fact), words) for alias, fact in firing.bindings},
            because=rules[firing.rule].because,
            references=tuple(rules[firing.rule].references),
            conditions=reader.conditions(rules[firing.rule], dict(firing.bindings)),
            actions=_actions(base, rules[firing.rule], firing),
        )
        for firing in result.firings
    ]


def _actions(base: RuleBase, rule: Rule, firing: Firing) -> tuple[ActionRecord, ...]:
    return tuple(
        ActionRecord(
            kind=action.kind, text=action_text(rule.then[action.index], base.thresholds), values=dict(action.values)
        )
        for action in firing.actions
    )


def finding_records(base: RuleBase, concluded: Mapping[Stage, Firings]) -> list[FindingRecord]:
    """Return the findings that rules derived, each with the rules and the stage it was first derived in."""
    rules = base.by_id
    sources: dict[tuple[str, str], list[tuple[Stage, str]]] = {}
    for stage, result in concluded.items():
        for firing in result.firings:
            for finding in filter(None, map(finding_of, rules[firing.rule].then)):
                key = str(finding.get("name")), str(finding.get("severity"))
                sources.setdefault(key, []).append((stage, firing.rule))
    return [
        FindingRecord(
            name=name,
            severity=severity,
            sentence=base.findings.get(name, name),
            rules=tuple(sorted({rule for _, rule in where})),
            stage=where[0][0],
        )
        for (name, severity), where in sources.items()
    ]


def finding_rank(record: FindingRecord) -> tuple[int, int, str]:
    """Return a key that puts the most severe findings first, then those of earlier stages."""
    return -SEVERITIES.index(record.severity), STAGES.index(record.stage), record.name


def inputs_record(pair: StereoPair) -> InputsRecord:
    """Record what the caller gave."""
    mount = None
    if pair.mount is not None:
        mount = tuple(map(float, (*np.ravel(pair.mount.rotation), *pair.mount.translation_m)))
    return InputsRecord(
        left=image_record(pair.left),
        right=image_record(pair.right),
        left_mask=None if pair.left_mask is None else image_record(pair.left_mask),
        right_mask=None if pair.right_mask is None else image_record(pair.right_mask),
        disparity_range_px=pair.disparity_range_px,
        calibration=None if pair.calibration is None else dataclasses.asdict(pair.calibration),
        attitude=None if pair.attitude is None else dataclasses.asdict(pair.attitude),
        mount=mount,
        rectified_here=pair.preparation.rectified_here,
    )


def image_record(image: Any) -> ImageRecord:
    """Record an image or a mask by its content."""
    return ImageRecord(sha256=array_digest(image), shape=image.shape, dtype=str(image.dtype))


def array_digest(array: Any) -> str:
    """Return the SHA-256 of an array's shape, type and content."""
    digest = hashlib.sha256(f"{array.shape}{array.dtype.str}".encode())
    digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def product_digests(disparity: Disparity | None, elevation: ElevationMap | None) -> dict[str, str]:
    """Return the SHA-256 of the products that were made."""
    found = {}
    if disparity is not None:
        found["disparity_px"] = array_digest(disparity.disparity_px)
        found["validity"] = array_digest(disparity.validity)
    if elevation is not None:
        found["elevation_m"] = array_digest(elevation.layers["elevation"])
    return found
