"""What the steps of a plan are predicted to cost, where a time budget is stated.

Rules choose by these predictions, never by the clock, so that a decision stays the same however busy the machine is.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from expert.facts import Fact, PredictedCost, to_fact
from expert.plan import NONE, StagePlan
from expert.rules.model import RuleBase, Slot
from modules.operator import Cost, Operator
from modules.probe import Probe

ALWAYS = "always"  # the step that holds what every plan takes
DECISION = Cost(fixed_ms=10.0, ns_per_pixel=6.0)  # inference, the record and the digests of images and products
RANGE = "matching.use_range"
CHOSEN_LATER = ("matcher", "confidence")  # slots of the matching that rules weigh by themselves
ASSUMED_RANGE = 0.25  # of the width, where no range is known yet: as MAT003 searches
REFERENCE_MS = 3.5  # of `measure_speed`'s work on the reference machine
STEPS_PER_SPEED = 8  # speeds are told in eighths
SLOWEST, FASTEST = 0.125, 8.0
ROUNDS = 5


@dataclass(frozen=True)
class Costs:
    """Predicts CPU times for one pair.

    Attributes
    ----------
    base : RuleBase
    operators, probes : mappings
        The catalog.
    pixels, columns : int
        Of one image.
    calibrated : bool
        Whether terrain is made of the disparity.
    speed : float
        Of this machine over the reference one.
    """

    base: RuleBase
    operators: Mapping[str, Operator]
    probes: Mapping[str, Probe]
    pixels: int
    columns: int
    calibrated: bool
    speed: float = 1.0

    def facts(self, known: Iterable[Fact]) -> dict[Fact, str | None]:
        """Return a `cost` fact per matcher, per probe of the pair, for the confidence, and for what every plan takes.

        What every plan takes holds the probes that always run; their own facts are there to be read, not to be added.
        """
        disparities = self._disparities(known)
        steps = {ALWAYS: self._always(disparities)}
        for name, operator in self.operators.items():
            if operator.stage == "matching" and operator.slot in CHOSEN_LATER:
                steps[name] = operator.cost.seconds(self.pixels, disparities)
        for name, probe in self.probes.items():
            if probe.subject == "pair":
                steps[name] = probe.cost.seconds(self.pixels)
        return {to_fact(PredictedCost(step=name, cpu_s=cost / self.speed)): None for name, cost in steps.items()}

    def of_plan(self, plan: StagePlan, known: Iterable[Fact]) -> float:
        """Return the CPU time of the steps of a plan, s, over the range that it searches itself."""
        planned = next((step.parameters for step in plan.steps if step.operator == RANGE), None)
        disparities = self._disparities(known) if planned is None else planned["max_px"] - planned["min_px"]
        costs = [self.operators[step.operator].cost for step in plan.steps if step.operator != NONE]
        return sum(cost.seconds(self.pixels, disparities) for cost in costs) / self.speed

    def of_probe(self, name: str) -> float:
        """Return the CPU time of a probe of the pair, s."""
        return self.probes[name].cost.seconds(self.pixels) / self.speed

    def beside_plans(self) -> float:
        """Return the CPU time of all that no plan holds, s: the decision, and the probes that always run."""
        return sum(cost.seconds(self.pixels) for cost in self._beside()) / self.speed

    def _beside(self) -> list[Cost]:
        return [DECISION, *(probe.cost for probe in self.probes.values() if _always_runs(probe))]

    def _always(self, disparities: int) -> float:
        costs = self._beside()
        costs += [
            self.operators[slot.default].cost for slot in self.base.slots.get("matching", ()) if self._plain(slot)
        ]
        if self.calibrated:
            costs += [item.cost for item in self.operators.values() if item.stage == "reconstruction"]
        return sum(cost.seconds(self.pixels, disparities) for cost in costs)

    def _plain(self, slot: Slot) -> bool:
        return slot.default in self.operators and slot.slot not in CHOSEN_LATER

    def _disparities(self, known: Iterable[Fact]) -> int:
        """Return the range known of this pair, else that of the pair before by the same rig, else an assumed one."""
        ranges = {
            fact.template: int(fact.numbers["max_px"] - fact.numbers["min_px"])
            for fact in known
            if (fact.template == "disparity_range" or (fact.template == "previous" and fact.get("same_rig")))
            and {"min_px", "max_px"} <= set(fact.numbers)
        }
        assumed = round(ASSUMED_RANGE * self.columns)
        return ranges.get("disparity_range", ranges.get("previous", assumed))


def _always_runs(probe: Probe) -> bool:
    return probe.tier == "cheap" and probe.subject in ("pair", "disparity")


def measure_speed() -> float:
    """Return the speed of this machine over the reference one, in eighths: a small match, the best of a few."""
    image = np.random.default_rng(0).integers(0, 255, (160, 320), np.uint8)
    matcher = cv2.StereoSGBM.create(0, 48, 5, 200, 800, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY)
    taken = []
    for _ in range(ROUNDS):
        begun = time.process_time()
        matcher.compute(image, image)
        taken.append(time.process_time() - begun)
    speed = REFERENCE_MS * 1e-3 / max(min(taken), 1e-6)
    return max(SLOWEST, min(FASTEST, round(speed * STEPS_PER_SPEED) / STEPS_PER_SPEED))
