"""The Python API: one class that decides about pairs and reconstructs them."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

from expert import explain
from expert.costs import Costs, measure_speed
from expert.decision import Decision, Status
from expert.engine import make_engine
from expert.facts import Available, Fact, FactModel, MeasuredAttitude, Rig, StatedRover, Task, to_fact, vocabulary
from expert.knowledge import Knowledge
from expert.pair import StereoPair
from expert.plan import Directives, StagePlan, StepFailed
from expert.recorder import inputs_record, product_digests
from expert.result import Result
from expert.rules.load import load_rules
from expert.rules.model import STAGES, RuleBase
from expert.supervise import Measured, Run
from expert.versions import versions
from expert.warm import previous_pair, thumbnail
from modules.catalog import operators, probes
from modules.measurement.sample import Sample
from modules.types import Matching, Rover, Scene, Views

Profile = Literal["fast", "balanced", "best"]
OPTIONAL_PACKAGES = ("numba",)


class ExpertSystem:
    """A stereo expert: shipped knowledge, rule files layered on top, an engine.

    One object serves any number of pairs, one after another or from several threads; nothing of a pair is kept. Threads
    share its engine: experta infers for one of them at a time, `compiled` for all at once. Processes make one each,
    under the start method `spawn`: image libraries may hang after `fork`. Decisions travel between processes, systems
    do not.

    Parameters
    ----------
    rules : sequence of path, optional
        Rule files layered on the shipped rules, later ones last.
    profile : {"fast", "balanced", "best"}
        A fact that rules read.
    engine : {"experta", "compiled"}
        The two agree on every decision.
    time_budget_s, memory_budget_mb : float, optional
        Facts that rules read.
    machine_speed : float, optional
        Speed of this machine over the one that costs were measured on. Measured here where a time budget is given and
        this is not: a decision by predicted costs is the same only at the same speed.
    rover : Rover, optional
        The vehicle that shall drive on the terrain; its size sets the limits of the traversability.

    Raises
    ------
    expert.rules.problem.RuleFileError
        A rule file is wrong; all problems are listed with their positions.

    Examples
    --------
    >>> from expert import ExpertSystem
    >>> ExpertSystem(engine="compiled").profile
    'balanced'
    """

    def __init__(
        self,
        rules: Sequence[str | Path] = (),
        profile: Profile = "balanced",
        engine: Literal["experta", "compiled"] = "experta",
        *,
        time_budget_s: float | None = None,
        memory_budget_mb: float | None = None,
        machine_speed: float | None = None,
        rover: Rover | None = None,
    ) -> None:
        self.profile = profile
        self._rover = None if rover is None else StatedRover(**asdict(rover))
        if time_budget_s is not None and machine_speed is None:
            machine_speed = measure_speed()
        self._task = Task(
            profile=profile,
            time_budget_s=time_budget_s,
            memory_budget_mb=memory_budget_mb,
            machine_speed=None if time_budget_s is None else machine_speed,
        )
        words = vocabulary(probes().values())
        loaded = load_rules([Path(path) for path in rules], words, operators(), probes())
        self._knowledge = Knowledge(loaded, make_engine(engine, words), operators(), probes())
        self._rules_record = explain.embed(loaded)

    @property
    def rules_digest(self) -> str:
        """SHA-256 of the rule base, layers included."""
        return self._knowledge.rules.digest

    @property
    def rule_base(self) -> RuleBase:
        """The rules in force, layers merged."""
        return self._knowledge.rules.base

    @property
    def rule_ids(self) -> tuple[str, ...]:
        """Ids of the rules, layers included, sorted."""
        return tuple(sorted(rule.id for rule in self._knowledge.rules.base.rules))

    def decide(
        self,
        pair: StereoPair,
        *,
        progress: Callable[[str], None] | None = None,
        measured: Measured | None = None,
        previous: Decision | None = None,
    ) -> Decision:
        """Measure the pair and plan every stage, without dense matching.

        Parameters
        ----------
        pair : StereoPair
        progress : callable, optional
            Called with the name of what begins.
        measured : dict, optional
            What was measured of this pair before, and is not measured again; what is measured now is added to it. Give
            the same dict to systems with other rules to compare their decisions about one pair.
        previous : Decision, optional
            About the pair before this one in a sequence; see `reconstruct`.

        Returns
        -------
        Decision
            With status `decided`, or `failed` where a critical finding forbids a reconstruction.
        """
        run = self._begin(pair, progress, measured, previous)
        for stage in STAGES[1:]:
            run.plan(stage)
        return self._decision(pair, run, "failed" if run.critical() else "decided", {})

    def reconstruct(
        self,
        pair: StereoPair,
        *,
        progress: Callable[[str], None] | None = None,
        previous: Decision | None = None,
    ) -> Result:
        """Run the whole loop on a pair.

        Bad scenes do not raise: the decision's status is `failed` and its findings say why.

        Parameters
        ----------
        pair : StereoPair
        progress : callable, optional
            Called with the name of what begins.
        previous : Decision, optional
            About the pair before this one in a sequence (`result.decision`). Where rig and scene are like then, rules
            take over what it found instead of measuring it again, and the report says so.
        """
        run = self._begin(pair, progress, previous=previous)
        if run.critical():
            return Result(self._decision(pair, run, "failed", {}), pair.views)
        corrector = _Corrector(run, pair.views)

        def unmatched(directives: Directives) -> Matching:
            return Matching(corrector.corrected(directives))

        matching: Matching | None = run.run_stage("matching", "disparity", unmatched)
        if matching is None or matching.disparity is None or run.critical():
            views, disparity = (matching.views, matching.disparity) if matching else (corrector.views, None)
            decision = self._decision(pair, run, "failed", product_digests(disparity, None))
            return Result(decision, views, disparity, original=pair.views)
        matchings = [(matching, matching.disparity)]

        def scene(directives: Directives) -> Scene:
            if directives.touch(("correction", "matching")):
                again: Matching = run.run_again("matching", "disparity", directives, unmatched)
                if again.disparity is not None:
                    matchings.append((again, again.disparity))
            return pair.scene(matchings[-1][0])

        final: Scene | None = run.run_stage("reconstruction", "terrain", scene)
        if final is not None:  # the matching that the kept terrain was made of
            matching = next(made for made, disparity in matchings if disparity is final.disparity)
        status: Status = "disparity_only" if pair.calibration is None else "reconstructed"
        if run.critical() or (pair.calibration is not None and (final is None or final.elevation is None)):
            status = "failed"
        points, elevation = (final.points, final.elevation) if final else (None, None)
        run.notes += [] if final is None else _level_told(final)
        decision = self._decision(pair, run, status, product_digests(matching.disparity, elevation))
        return Result(decision, matching.views, matching.disparity, points, elevation, original=pair.views)

    def _begin(
        self,
        pair: StereoPair,
        progress: Callable[[str], None] | None,
        measured: Measured | None = None,
        previous: Decision | None = None,
    ) -> Run:
        facts: dict[Fact, str | None] = {to_fact(model): None for model in self._stated(pair)}
        before = None if previous is None else previous_pair(previous, pair)
        if before is not None:
            facts[to_fact(before)] = None
        run = Run(self._knowledge, Sample(pair.views, pair.given_range), facts, costs=self._costs(pair))
        run.memory = {} if measured is None else measured
        if progress is not None:
            run.progress = progress
        run.notes += pair.preparation.told(pair.valid_fraction)
        run.decide_measurement()
        return run

    def _costs(self, pair: StereoPair) -> Costs | None:
        """Return what predicts the costs of a pair, where a time budget is stated."""
        if self._task.time_budget_s is None:
            return None
        rows, columns = pair.views.shape
        known = self._knowledge
        speed = self._task.machine_speed or 1.0
        calibrated = pair.calibration is not None
        return Costs(known.rules.base, known.operators, known.probes, rows * columns, columns, calibrated, speed)

    def _stated(self, pair: StereoPair) -> list[FactModel]:
        camera, attitude = pair.calibration, pair.attitude
        rig = Rig(calibrated=False)
        if camera is not None:
            done = pair.preparation
            rig = Rig(
                calibrated=True,
                focal_px=camera.focal_px,
                baseline_m=camera.baseline_m,
                doffs_px=camera.doffs_px,
                rectified_here=done.rectified_here,
                valid_fraction=pair.valid_fraction if done.rectified_here else None,
                calibration_scale=done.calibration_scale if done.calibration_scale != 1.0 else None,
            )
        known = MeasuredAttitude(known=attitude is not None)
        if attitude is not None:
            degrees = 57.29577951308232
            known = MeasuredAttitude(
                known=True,
                roll_deg=attitude.roll_rad * degrees,
                pitch_deg=attitude.pitch_rad * degrees,
                sigma_deg=attitude.sigma_rad * degrees if attitude.sigma_rad > 0.0 else None,
            )
        task = self._task.model_copy(update={"range_given": pair.disparity_range_px is not None})
        installed = [
            Available(package=name, installed=importlib.util.find_spec(name) is not None) for name in OPTIONAL_PACKAGES
        ]
        rover = [] if self._rover is None else [self._rover]
        return [task, rig, known, *rover, *installed]

    def _decision(self, pair: StereoPair, run: Run, status: Status, products: dict[str, str]) -> Decision:
        return Decision(
            pair=pair.name,
            status=status,
            profile=self.profile,
            rules_digest=self._knowledge.rules.digest,
            inputs=inputs_record(pair),
            facts=run.fact_records(),
            firings=run.firing_records(),
            findings=run.findings(),
            plans={plan.stage: plan for plan in run.plans.values()},
            trials=tuple(run.trials),
            notes=tuple(run.notes),
            products=products,
            engine=self._knowledge.engine.name,
            versions=versions(),
            timings_s={name: round(seconds, 6) for name, seconds in run.timings_s.items()},
            rules=self._rules_record,
            thumbnail=thumbnail(pair.left),
        )


def _level_told(scene: Scene) -> list[str]:
    """Say how uncertain level is, where the ground took part in finding it."""
    if scene.ground is None or scene.attitude is None:
        return []
    sigma = scene.attitude.sigma_rad
    return [
        f"level comes from the ground itself: roll and pitch are uncertain by {math.degrees(sigma):.1f} deg, "
        f"which is {100 * math.tan(sigma):.0f} cm of height for every metre of distance"
    ]


class _Corrector:
    """Corrects a pair as the directives ask, and again only when the plan of the correction changes."""

    def __init__(self, run: Run, original: Views) -> None:
        self._run, self._original = run, original
        self._done: dict[Any, Views] = {}
        self._failed: frozenset[str] = frozenset()
        self.views = original

    def corrected(self, directives: Directives) -> Views:
        """Return the corrected pair; an operator that fails is excluded, and the rules are asked again."""
        plan = self._run.plan("correction", directives, self._failed)
        while plan.configuration() not in self._done:
            try:
                self._done[plan.configuration()] = self._run.execute(plan, self._original)
            except StepFailed as error:
                self._run.record_failure(plan, len(self._failed) + 1, error)
                if error.operator in self._failed:  # the default of a slot, which nothing excludes
                    plan = self._run.plans["correction"] = StagePlan(stage="correction", steps=())
                    self._run.notes.append("the pair was matched uncorrected")
                else:
                    self._failed |= {error.operator}
                    plan = self._run.plan("correction", directives, self._failed)
        self.views = self._done[plan.configuration()]
        return self.views
