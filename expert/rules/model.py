"""The rule language as data: conditions, actions, rules, slots and the rule base.

Semantics, in one place:

- A top-level positive condition binds an *alias* (`as`, by default the template's name) to one fact. Conditions with
  the same alias speak of the same fact. A rule fires once for every way to bind its aliases: its *bindings*.
- An operand may name a field of another alias, `{field: other.mean_dn}`: a join.
- `not`, `any_of`, `exists` and `for_all` are tests on those bindings. An alias that is not bound outside them is
  existential inside them.
- A comparison with an absent field is false; its negation is true. `present` and `absent` ask for that.
- Rules only add. The findings they derive are facts; negation and quantifiers over findings are stratified.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Discriminator, Field, StringConstraints, Tag

from expert.facts import Severity

if TYPE_CHECKING:
    from typing_extensions import Self

Stage = Literal["measurement", "correction", "matching", "reconstruction"]
STAGES: tuple[Stage, ...] = ("measurement", "correction", "matching", "reconstruction")
Scalar = bool | int | float | str
Op = Literal[
    "eq", "ne", "lt", "le", "gt", "ge", "abs_lt", "abs_le", "abs_gt", "abs_ge",
    "between", "in", "not_in", "present", "absent", "significantly_gt", "significantly_lt",
]  # fmt: skip


class Model(BaseModel):
    """Base of all models of the rule file: frozen and closed."""

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True, allow_inf_nan=False)


class FieldRef(Model):
    """A field of a bound fact, `alias.field`."""

    field: str = Field(pattern=r"^[a-z_][a-z0-9_]*\.[a-z_][a-z0-9_]*$")


class ThresholdRef(Model):
    """A threshold declared at the top of the file."""

    threshold: str


class Quantity(Model):
    """A constant with a unit, for products: `{value: 0.1, unit: 1/px}`."""

    value: float
    unit: str


class Calculation(Model):
    """Bounded arithmetic: exactly one operation on operands. Every operation is total."""

    add: list[Operand] | None = Field(None, min_length=2)
    sub: list[Operand] | None = Field(None, min_length=2, max_length=2)
    mul: list[Operand] | None = Field(None, min_length=2)
    div: list[Operand] | None = Field(None, min_length=2, max_length=2)
    min: list[Operand] | None = Field(None, min_length=2)
    max: list[Operand] | None = Field(None, min_length=2)
    clamp: list[Operand] | None = Field(None, min_length=3, max_length=3)
    round: Operand | None = None
    floor: Operand | None = None
    ceil: Operand | None = None

    def operation(self) -> tuple[str, list[Any]]:
        """Return the operation's name and its operands."""
        name = next(iter(self.model_fields_set))
        value = getattr(self, name)
        return name, value if isinstance(value, list) else [value]


def _operand_kind(value: Any) -> str:
    if isinstance(value, FieldRef) or (isinstance(value, dict) and "field" in value):
        return "field"
    if isinstance(value, ThresholdRef) or (isinstance(value, dict) and "threshold" in value):
        return "threshold"
    if isinstance(value, Quantity) or (isinstance(value, dict) and "value" in value):
        return "quantity"
    if isinstance(value, Calculation | dict):
        return "calculation"
    return "scalar"


Operand = Annotated[
    Annotated[Scalar, Tag("scalar")]
    | Annotated[FieldRef, Tag("field")]
    | Annotated[ThresholdRef, Tag("threshold")]
    | Annotated[Quantity, Tag("quantity")]
    | Annotated[Calculation, Tag("calculation")],
    Discriminator(_operand_kind),
]
Calculation.model_rebuild()


class Comparison(Model):
    """A comparison on one field of a fact; without `op` it only asks that the fact exists."""

    fact: str
    alias: str | None = Field(None, alias="as")
    field: str | None = None
    op: Op = "present"
    value: Operand | list[Scalar | ThresholdRef] | None = None
    unit: str | None = None

    @property
    def name(self) -> str:
        """The alias it binds."""
        return self.alias or self.fact


class FindingCondition(Model):
    """A finding of at least a severity."""

    finding: str
    at_least: Severity = "minor"


class Not(Model):
    """True when the conditions inside do not all hold together."""

    not_: Condition | list[Condition] = Field(alias="not")


class AnyOf(Model):
    """True when one of the branches holds; a branch is a condition or a list of conditions."""

    any_of: list[Condition | list[Condition]] = Field(min_length=1)


class Exists(Model):
    """True when some facts satisfy all the conditions."""

    exists: Condition | list[Condition]


class ForAllBody(Model):
    """Which facts, and what has to hold for each of them."""

    where: list[Condition] = Field(min_length=1)
    then: list[Condition] = Field(min_length=1)


class ForAll(Model):
    """True when every binding of `where` also satisfies `then`; true when there is none."""

    for_all: ForAllBody


def _condition_kind(value: Any) -> str:
    keys = value if isinstance(value, dict) else getattr(value, "model_fields_set", ())
    for kind in ("finding", "not", "not_", "any_of", "exists", "for_all"):
        if kind in keys:
            return kind.rstrip("_")
    return "fact"


Condition = Annotated[
    Annotated[Comparison, Tag("fact")]
    | Annotated[FindingCondition, Tag("finding")]
    | Annotated[Not, Tag("not")]
    | Annotated[AnyOf, Tag("any_of")]
    | Annotated[Exists, Tag("exists")]
    | Annotated[ForAll, Tag("for_all")],
    Discriminator(_condition_kind),
]
for _model in (Not, AnyOf, Exists, ForAllBody, ForAll):
    _model.model_rebuild()


class Derive(Model):
    """Derive a finding."""

    derive: str
    severity: Severity = "minor"


class Measure(Model):
    """Ask for a dearer probe."""

    measure: str


class Choose(Model):
    """Propose an operator for its slot, with parameters; `none` needs the slot's name."""

    choose: str
    slot: str | None = None
    with_: dict[str, Operand] = Field(default_factory=dict, alias="with")
    score: float = Field(0.5, ge=0, le=1)


class Exclude(Model):
    """Forbid an operator, or leave a cheap probe of the pair out (stage measurement)."""

    exclude: str


class Set(Model):
    """Set one parameter of an operator, whoever chose it."""

    set: str
    parameter: str
    to: Operand
    score: float = Field(0.5, ge=0, le=1)


class Assess(Model):
    """Judge a product: a finding about it."""

    assess: str
    severity: Severity = "minor"


class Adjust(Model):
    """Change a parameter of an operator by a bounded step and run the stage again."""

    adjust: str
    parameter: str
    by: float | None = None
    times: float | None = None
    at_least: float | None = None
    at_most: float | None = None


class Repair(Model):
    """Run again with another operator, of this stage or of an earlier one; `none` needs the slot's name."""

    repair: str
    slot: str | None = None
    with_: dict[str, Operand] = Field(default_factory=dict, alias="with")
    score: float = Field(0.9, ge=0, le=1)


ACTIONS = ("derive", "measure", "choose", "exclude", "set", "assess", "adjust", "repair")


def _action_kind(value: Any) -> str | None:
    keys = value if isinstance(value, dict) else getattr(type(value), "model_fields", ())
    return next((kind for kind in ACTIONS if kind in keys), None)


Action = Annotated[
    Annotated[Derive, Tag("derive")]
    | Annotated[Measure, Tag("measure")]
    | Annotated[Choose, Tag("choose")]
    | Annotated[Exclude, Tag("exclude")]
    | Annotated[Set, Tag("set")]
    | Annotated[Assess, Tag("assess")]
    | Annotated[Adjust, Tag("adjust")]
    | Annotated[Repair, Tag("repair")],
    Discriminator(_action_kind),
]


class Rule(Model):
    """One piece of expertise."""

    id: str = Field(pattern=r"^[A-Z]{3}[0-9]{3}$")
    name: str = Field(pattern=r"^[a-z][a-z0-9-]*$")
    stage: Stage
    priority: int = Field(100, ge=0, le=1000)
    when: list[Condition] = Field(min_length=1)
    then: list[Action] = Field(min_length=1)
    because: Annotated[str, StringConstraints(strip_whitespace=True, min_length=10)]
    references: list[str] = Field(min_length=1)


class Threshold(Model):
    """A named number that several rules share."""

    value: float
    unit: str = "1"
    because: str


class Slot(Model):
    """One place of a stage's plan, with the operator that fills it when no rule chooses."""

    slot: str
    default: str = "none"
    with_: dict[str, Scalar] = Field(default_factory=dict, alias="with")
    because: str


class RuleBase(Model):
    """A whole rule file, or several layered ones."""

    version: Literal[1] = 1
    thresholds: dict[str, Threshold] = Field(default_factory=dict)
    findings: dict[str, str] = Field(default_factory=dict)
    slots: dict[Stage, list[Slot]] = Field(default_factory=dict)
    disable: list[str] = Field(default_factory=list)
    rules: list[Rule] = Field(default_factory=list)

    @cached_property
    def by_id(self) -> Mapping[str, Rule]:
        """The rules by their ids."""
        return {rule.id: rule for rule in self.rules}

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy, changed as asked, that knows its own rules by id."""
        copy = super().model_copy(update=update, deep=deep)
        copy.__dict__.pop("by_id", None)
        return copy

    def of_stage(self, stage: Stage) -> tuple[Rule, ...]:
        """Return the rules of one stage, by id."""
        return tuple(sorted((rule for rule in self.rules if rule.stage == stage), key=lambda rule: rule.id))
