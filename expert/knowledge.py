"""What every pair is decided with: rules, an engine, operators and probes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from expert.facts import Vocabulary, vocabulary
from expert.firing import Engine
from expert.rules.load import LoadedRules
from expert.rules.model import Exclude, RuleBase
from expert.rules.strata import with_sources
from modules.operator import Operator
from modules.probe import Probe


@dataclass(frozen=True)
class Knowledge:
    """What every pair is decided with."""

    rules: LoadedRules
    engine: Engine
    operators: Mapping[str, Operator]
    probes: Mapping[str, Probe]

    @cached_property
    def words(self) -> Vocabulary:
        """Every template that rules may speak of."""
        return vocabulary(self.probes.values())

    @cached_property
    def leaving_out(self) -> RuleBase | None:
        """The rules of the measurement that may leave a probe out, and what these build on; None if there are none."""
        base = self.rules.base
        rules = with_sources(base.of_stage("measurement"), lambda rule: any(isinstance(a, Exclude) for a in rule.then))
        return base.model_copy(update={"rules": list(rules)}) if rules else None
