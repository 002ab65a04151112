"""What every pair is decided with: rules, an engine, operators and probes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from expert.facts import Vocabulary, vocabulary
from expert.firing import Engine
from expert.rules.load import LoadedRules
from expert.rules.model import Exclude, Rule
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
    def by_id(self) -> Mapping[str, Rule]:
        """The rules in force."""
        return {rule.id: rule for rule in self.rules.base.rules}

    @cached_property
    def leaves_out(self) -> bool:
        """Whether some rule may leave a probe out."""
        measuring = self.rules.base.of_stage("measurement")
        return any(isinstance(action, Exclude) for rule in measuring for action in rule.then)
