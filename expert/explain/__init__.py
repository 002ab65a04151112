"""Explanations of a decision: how, why not, what if, what would it take.

Computed from the rule base and the record alone, so a saved `decision.json` explains itself as well as a fresh one.
Where an inference is needed, any engine is taken as an argument.
"""

from expert.explain.embedded import embed, rules_of
from expert.explain.how import how
from expert.explain.margins import FieldMargins, Margins, RuleMargin, margins
from expert.explain.model import How, WhatIf, WhatItTakes, WhyNot
from expert.explain.record import ExplainError, check_digest
from expert.explain.take import what_would_it_take
from expert.explain.what_if import what_if
from expert.explain.why_not import not_chosen, why_not

__all__ = [
    "ExplainError",
    "FieldMargins",
    "How",
    "Margins",
    "RuleMargin",
    "WhatIf",
    "WhatItTakes",
    "WhyNot",
    "check_digest",
    "embed",
    "how",
    "margins",
    "not_chosen",
    "rules_of",
    "what_if",
    "what_would_it_take",
    "why_not",
]
