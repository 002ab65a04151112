"""The decision record: what was measured, which rules fired, what was chosen, tried and found. Data only."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from expert.facts import Scalar
from expert.plan import Record, StagePlan, Step
from expert.rules.model import Stage

if TYPE_CHECKING:
    from expert.explain import How, Margins, WhatIf, WhatItTakes, WhyNot

SCHEMA_VERSION = 2
BESIDE_CORE = {"products", "engine", "versions", "timings_s", "rules", "thumbnail"}
Status = Literal["decided", "reconstructed", "disparity_only", "failed"]


class FactRecord(Record):
    """A fact.

    Attributes
    ----------
    units : dict of str to str
        Units of the fields that have one.
    probe : str or None
        What measured it; None for what the caller stated and what the loop counted.
    """

    template: str
    fields: dict[str, Scalar]
    units: dict[str, str] = Field(default_factory=dict)
    probe: str | None = None


class ConditionRecord(Record):
    """One comparison of a rule, or one finding it asks for, and what was measured.

    Attributes
    ----------
    text : str
        The condition in words.
    holds : bool
        Whether it holds by itself, whatever group it stands in.
    template, fact, field : str or None
        What it reads; `fact` also says which of several, and is None where there is no such fact.
    value, limit : scalar or None
        The two sides; several limits for a range or a list. None where they are not known.
    threshold : str or None
        Name of the threshold that the limit is.
    margin : float or None
        How far the value is on the side where the condition holds, in `unit`; negative where it does not hold. None
        where it is no order between numbers.
    within : tuple of str
        The groups around it, the outermost first: `not`, `exists`, `any_of 1`, `for_all where`.
    """

    text: str
    holds: bool = False
    template: str | None = None
    fact: str | None = None
    field: str | None = None
    op: str | None = None
    value: Scalar | None = None
    limit: Scalar | tuple[Scalar, ...] | None = None
    unit: str = "1"
    threshold: str | None = None
    margin: float | None = None
    within: tuple[str, ...] = ()


class ActionRecord(Record):
    """What a firing concluded, in words, with the values of its operands; an action without them was left out."""

    kind: str
    text: str
    values: dict[str, Scalar] = Field(default_factory=dict)


class FiringRecord(Record):
    """A rule that fired: on which facts, by which conditions, with which conclusions."""

    rule: str
    name: str
    stage: Stage
    bindings: dict[str, FactRecord]
    because: str
    references: tuple[str, ...] = ()
    conditions: tuple[ConditionRecord, ...] = ()
    actions: tuple[ActionRecord, ...] = ()


class FindingRecord(Record):
    """A finding with the rules that derived it."""

    name: str
    severity: str
    sentence: str
    rules: tuple[str, ...]
    stage: Stage


class TrialRecord(Record):
    """One trial of a stage: the plan, what was measured of its product, and what the assessment concluded."""

    stage: Stage
    number: int
    plan: StagePlan
    product_facts: tuple[FactRecord, ...] = ()
    score: float | None = None
    failure: str | None = None
    kept: bool = False
    answer: str = "accepted"


class ImageRecord(Record):
    """One input image, by the SHA-256 of its shape, type and pixels."""

    sha256: str
    shape: tuple[int, ...]
    dtype: str


class InputsRecord(Record):
    """What the caller gave, after rectification where that was asked for; with the images the plan can run again.

    Attributes
    ----------
    left_mask, right_mask : ImageRecord or None
        None where every pixel may be used.
    calibration, attitude : dict of str to float, or None
        Fields of `Calibration` and `Attitude`, px, m and rad.
    mount : tuple of float, or None
        Rotation by rows and translation, m, of the left camera on the body; None for the usual mount.
    rectified_here : bool
        Whether the images were rectified while they were loaded, so that the files hold others.
    """

    left: ImageRecord
    right: ImageRecord
    left_mask: ImageRecord | None = None
    right_mask: ImageRecord | None = None
    disparity_range_px: tuple[int, int] | None = None
    calibration: dict[str, int | float] | None = None
    attitude: dict[str, float | None] | None = None
    mount: tuple[float, ...] | None = None
    rectified_here: bool = False

    @property
    def digest(self) -> str:
        """SHA-256 of all of it."""
        return hashlib.sha256(_canonical(self.model_dump(mode="json"))).hexdigest()


class RulesRecord(Record):
    """The rule base that decided, so that the record explains itself when the files have changed.

    Attributes
    ----------
    files : tuple of str
        Layers, the lowest first.
    positions : dict of str to (str, int)
        File and line of every rule.
    content : str
        Canonical JSON of the rule base, gzip, base64; its SHA-256 is the decision's `rules_digest`.
    """

    files: tuple[str, ...] = ()
    positions: dict[str, tuple[str, int]] = Field(default_factory=dict)
    content: str


class Decision(Record):
    """Everything that was decided about one pair.

    `core()` is the canonical part: the same pair, rules and library versions give the same bytes. Times, versions, the
    text of the rules, digests of the products and the thumbnail stand beside it.

    Attributes
    ----------
    products : dict of str to str
        SHA-256 of the disparity, its validity and the elevation, where they were made.
    rules : RulesRecord or None
        The rules themselves; `rules_digest` says which they are.
    thumbnail : str
        Tiny gray copy of the left image, by which the next pair of a sequence tells how much has changed.
    """

    schema_version: int = SCHEMA_VERSION
    pair: str
    status: Status
    profile: str
    rules_digest: str
    inputs: InputsRecord
    facts: tuple[FactRecord, ...]
    firings: tuple[FiringRecord, ...]
    findings: tuple[FindingRecord, ...]
    plans: dict[str, StagePlan]
    trials: tuple[TrialRecord, ...] = ()
    notes: tuple[str, ...] = ()
    products: dict[str, str] = Field(default_factory=dict)
    engine: str = ""
    versions: dict[str, str] = Field(default_factory=dict)
    timings_s: dict[str, float] = Field(default_factory=dict)
    rules: RulesRecord | None = None
    thumbnail: str = ""

    def core(self) -> bytes:
        """Return the canonical core as JSON bytes: no engine, no times, no versions."""
        return _canonical(self.model_dump(mode="json", exclude=BESIDE_CORE))

    @property
    def inputs_digest(self) -> str:
        """SHA-256 of what the caller gave."""
        return self.inputs.digest

    @property
    def id(self) -> str:
        """SHA-256 of the core, first 16 hex digits."""
        return hashlib.sha256(self.core()).hexdigest()[:16]

    def to_json(self) -> str:
        """Return the whole record as indented JSON, its id first."""
        data: dict[str, Any] = {"decision_id": self.id, **self.model_dump(mode="json")}
        return json.dumps(data, indent=1, ensure_ascii=False) + "\n"

    @classmethod
    def from_json(cls, text: str) -> Decision:
        """Read a record that `to_json` wrote.

        Raises
        ------
        ValueError
            It is not such a record, is of another schema version, or was changed after it was written.
        """
        data = json.loads(text)
        if not isinstance(data, dict) or "decision_id" not in data:
            raise ValueError("not a decision record: there is no decision_id")
        if data.get("schema_version") != SCHEMA_VERSION:
            found = data.get("schema_version")
            raise ValueError(f"the record has schema version {found!r}, this program reads {SCHEMA_VERSION}")
        written = data.pop("decision_id")
        decision = cls.model_validate(data)
        if decision.id != written:
            raise ValueError(f"the record was changed after it was written: its id is {written!r}, not {decision.id}")
        return decision

    @property
    def rules_fired(self) -> tuple[str, ...]:
        """Ids of the rules that fired, sorted."""
        return tuple(sorted({firing.rule for firing in self.firings}))

    def steps(self) -> tuple[Step, ...]:
        """Return the steps of the final plan over all stages, in the order they run, `none` left out."""
        return tuple(step for plan in self.plans.values() for step in plan.steps if step.operator != "none")

    def operator(self, slot: str) -> str:
        """Return the operator that fills `stage.slot`, or `none`."""
        stage, _, name = slot.partition(".")
        return self.plans[stage].operator_of(name) if stage in self.plans else "none"

    def how(self, subject: str) -> How:
        """Tell how a choice came about.

        Parameters
        ----------
        subject : str
            A stage, a slot (`matching.matcher`), an operator of the plan, or a finding.

        Raises
        ------
        expert.explain.ExplainError
            The decision knows no such thing, or carries no rules. The same holds for the other questions.
        """
        from expert import explain

        return explain.how(self, subject, explain.rules_of(self))

    def why_not(self, name: str) -> WhyNot:
        """Tell why an operator was not chosen, or why a rule did not fire."""
        from expert import explain

        return explain.why_not(self, explain.rules_of(self), name)

    def what_if(self, overrides: Mapping[str, Scalar | None]) -> WhatIf:
        """Tell what would be planned if facts had other values, e.g. `{"brightness.mean_difference_dn": 0.0}`."""
        from expert import explain
        from expert.engine import any_engine

        return explain.what_if(self, explain.rules_of(self), any_engine(), overrides)

    def what_would_it_take(self, wanted: str) -> WhatItTakes:
        """Tell the smallest change of facts that gives an operator, or `stage.slot=operator`."""
        from expert import explain
        from expert.engine import any_engine

        return explain.what_would_it_take(self, explain.rules_of(self), any_engine(), wanted)

    def margins(self) -> Margins:
        """Tell how near every condition of every rule was to its limit."""
        from expert import explain

        return explain.margins(self, explain.rules_of(self))

    def text(self) -> str:
        """Return the explanation for a terminal."""
        from expert.report import as_text

        return as_text(self)


def _canonical(data: dict[str, Any]) -> bytes:
    return json.dumps(data, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()


def record_schema() -> dict[str, Any]:
    """Return the JSON Schema of `decision.json`."""
    schema = Decision.model_json_schema(mode="serialization")
    text = "SHA-256 of the canonical core, first 16 hex digits"
    schema["properties"] = {
        "decision_id": {"description": text, "pattern": "^[0-9a-f]{16}$", "type": "string"},
        **schema["properties"],
        "schema_version": {"const": SCHEMA_VERSION, "description": "Raised when the meaning of a key changes"},
    }
    schema["required"] = ["decision_id", "schema_version", *schema["required"]]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": "terrex decision record",
    }
