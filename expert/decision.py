"""The decision record: what was measured, which rules fired, what was chosen, tried and found. Data only."""

from __future__ import annotations

import hashlib
import json
from typing import Any, Literal

from pydantic import Field

from expert.facts import Fact, Scalar
from expert.plan import Record, StagePlan, Step
from expert.rules.model import Stage

SCHEMA_VERSION = 1
Status = Literal["decided", "reconstructed", "disparity_only", "failed"]


class FactRecord(Record):
    """A fact, and the probe that measured it (None for what the caller stated)."""

    template: str
    fields: dict[str, Scalar]
    probe: str | None = None


class FiringRecord(Record):
    """A rule that fired, on which facts."""

    rule: str
    name: str
    stage: Stage
    bindings: dict[str, FactRecord]
    because: str


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


class Decision(Record):
    """Everything that was decided about one pair.

    `core()` is the canonical part: the same pair, rules and library versions give the same bytes. Times and versions
    stand beside it.
    """

    schema_version: int = SCHEMA_VERSION
    pair: str
    status: Status
    profile: str
    rules_digest: str
    inputs_digest: str
    facts: tuple[FactRecord, ...]
    firings: tuple[FiringRecord, ...]
    findings: tuple[FindingRecord, ...]
    plans: dict[str, StagePlan]
    trials: tuple[TrialRecord, ...] = ()
    notes: tuple[str, ...] = ()
    engine: str = ""
    versions: dict[str, str] = Field(default_factory=dict)
    timings_s: dict[str, float] = Field(default_factory=dict)

    def core(self) -> bytes:
        """Return the canonical core as JSON bytes: no engine, no times, no versions."""
        data = self.model_dump(mode="json", exclude={"engine", "versions", "timings_s"})
        return json.dumps(data, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()

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

    def text(self) -> str:
        """Return the explanation for a terminal."""
        from expert.report import as_text

        return as_text(self)


def fact_record(fact: Fact, probe: str | None) -> FactRecord:
    """Turn a fact into its record."""
    return FactRecord(template=fact.template, fields=fact.as_dict(), probe=probe)
