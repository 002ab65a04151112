"""terrex: a rule-based expert system that reconstructs 3D terrain from stereo pairs and explains every decision."""

from expert.api import ExpertSystem
from expert.decision import Decision
from expert.pair import PairError, StereoPair
from expert.result import Result

__all__ = ["Decision", "ExpertSystem", "PairError", "Result", "StereoPair"]
