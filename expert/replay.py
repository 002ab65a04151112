"""Run a saved plan again, without any rule, and compare its inputs and products with the record."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from expert.decision import Decision, InputsRecord
from expert.pair import StereoPair
from expert.plan import StagePlan, StepFailed, execute
from expert.recorder import inputs_record, product_digests
from expert.result import Result
from expert.versions import versions
from modules.catalog import operators
from modules.formats.images import read_image
from modules.types import Attitude, Calibration, Matching, Mount, Scene


class ReplayError(ValueError):
    """A record whose plan cannot be run again on what was given."""


@dataclass(frozen=True)
class Replayed:
    """What a saved plan gave.

    Attributes
    ----------
    result : Result
        The products, with the record they were asked of.
    verified : tuple of str
        What has the digest that the record names.
    differences : tuple of str
        What has not, one sentence each; empty when everything is the same.
    """

    result: Result
    verified: tuple[str, ...]
    differences: tuple[str, ...]

    @property
    def same(self) -> bool:
        """Whether inputs and products are those of the record."""
        return not self.differences

    def text(self) -> str:
        """Write it as lines."""
        record = self.result.decision
        ran = [step.operator for step in record.steps()]
        lines = [f"{record.pair}: the plan of decision {record.id} was run, {len(ran)} operators and no rule."]
        lines += [f"  {operator}" for operator in ran]
        lines += [f"same: {item}" for item in self.verified]
        lines += [f"differs: {item}" for item in self.differences]
        if not record.products:
            lines.append("the record names no products to compare with: it was decided, not run")
        return "\n".join(lines) + "\n"


def load_recorded_pair(inputs: InputsRecord, left: str | Path, right: str | Path) -> StereoPair:
    """Read two images as the pair of a record: with its calibration, attitude, mount and range.

    Raises
    ------
    ReplayError
        The images of the record were rectified while they were loaded, or had masks, which no image file holds.
    modules.formats.FormatError
        A file cannot be read.
    expert.pair.PairError
        The images do not fit together, or not to the recorded calibration.
    """
    if inputs.rectified_here:
        raise ReplayError(
            "the images of this record were rectified while they were loaded; give the calibration of that run with "
            "--calibration, and its --alpha if there was one"
        )
    if inputs.left_mask is not None or inputs.right_mask is not None:
        raise ReplayError("the pair of this record had masks; replay it from Python, on a StereoPair with these masks")
    mount = None
    if inputs.mount is not None:
        *rotation, x, y, z = inputs.mount
        mount = Mount(np.asarray(rotation, np.float64).reshape(3, 3), (x, y, z))
    camera: Mapping[str, Any] | None = inputs.calibration
    attitude: Mapping[str, Any] | None = inputs.attitude
    return StereoPair(
        read_image(Path(left)),
        read_image(Path(right)),
        disparity_range_px=inputs.disparity_range_px,
        calibration=None if camera is None else Calibration(**camera),
        attitude=None if attitude is None else Attitude(**attitude),
        mount=mount,
        name=Path(left).stem,
    )


def as_recorded(pair: StereoPair, inputs: InputsRecord) -> StereoPair:
    """Return a pair with the attitude and the range of a record, its calibration being its own."""
    attitude: Mapping[str, Any] | None = inputs.attitude
    return replace(
        pair,
        attitude=None if attitude is None else Attitude(**attitude),
        disparity_range_px=inputs.disparity_range_px,
    )


def run_plans(
    plans: Mapping[str, StagePlan],
    pair: StereoPair,
    around: Callable[[str], AbstractContextManager[Any]] = nullcontext,
) -> tuple[Matching, Scene | None]:
    """Run the plans of all stages on a pair, as they are and without any rule.

    Parameters
    ----------
    plans : mapping of str to StagePlan
        `decision.plans`; stages that are missing are left out.
    pair : StereoPair
    around : callable, optional
        Gives a context for every step, by the name of its operator.

    Returns
    -------
    matching : Matching
        The corrected views and the disparity.
    scene : Scene or None
        The terrain; None where there is no plan for it, or no disparity.

    Raises
    ------
    expert.plan.PlanError
        This installation has no such operator, or it takes no such parameters.
    expert.plan.StepFailed
        An operator could not do its work.
    """
    catalog = operators()
    views = pair.views
    if "correction" in plans:
        views = execute(plans["correction"], views, catalog, around)
    matching = Matching(views)
    if "matching" in plans:
        matching = execute(plans["matching"], matching, catalog, around)
    if "reconstruction" not in plans or matching.disparity is None:
        return matching, None
    return matching, execute(plans["reconstruction"], pair.scene(matching), catalog, around)


def replay(
    decision: Decision, pair: StereoPair, around: Callable[[str], AbstractContextManager[Any]] = nullcontext
) -> Replayed:
    """Run exactly the plan of a record on its pair, and compare inputs and products by their digests.

    Parameters
    ----------
    decision : Decision
    pair : StereoPair
        `load_recorded_pair` gives it from the two images.
    around : callable, optional
        Gives a context for every step, by the name of its operator.

    Returns
    -------
    Replayed

    Raises
    ------
    ReplayError
        The record has no plan, or an operator could not do its work; inputs that differ are named.
    expert.plan.PlanError
        As `run_plans`.

    Examples
    --------
    >>> from expert.replay import load_recorded_pair, replay  # doctest: +SKIP
    >>> pair = load_recorded_pair(decision.inputs, "left.png", "right.png")  # doctest: +SKIP
    >>> replay(decision, pair).same  # doctest: +SKIP
    True
    """
    if not decision.plans:
        said = "; ".join(finding.sentence for finding in decision.findings if finding.severity == "critical")
        raise ReplayError(f"the record has no plan to run: {said or 'nothing was planned'}")
    given = inputs_record(pair)
    compared = [*_compared(_inputs(decision.inputs), _inputs(given))]
    if _exchanged(decision.inputs, given):
        compared.insert(0, ("order", "left and right are exchanged"))
    try:
        matching, scene = run_plans(decision.plans, pair, around)
    except StepFailed as error:
        other = "; ".join(difference for _, difference in compared if difference is not None)
        said = f"{error} (the inputs are not those of the record: {other})" if other else str(error)
        raise ReplayError(said) from error
    points, elevation = (scene.points, scene.elevation) if scene else (None, None)
    result = Result(decision, matching.views, matching.disparity, points, elevation, original=pair.views)
    if decision.products:
        compared += _compared(decision.products, product_digests(matching.disparity, elevation))
    same = tuple(name for name, difference in compared if difference is None)
    differences = [difference for _, difference in compared if difference is not None]
    if differences:
        differences += _other_versions(decision.versions, versions())
    return Replayed(result, same, tuple(differences))


def _inputs(inputs: InputsRecord) -> dict[str, str]:
    """Return every input as a text that is equal where the input is."""
    found = {}
    for name in ("left", "right", "left_mask", "right_mask"):
        image = getattr(inputs, name)
        if image is not None:
            found[f"{name.replace('_', ' ')} image" if "mask" not in name else name.replace("_", " ")] = image.sha256
    for name in ("calibration", "attitude", "mount", "disparity_range_px"):
        value = getattr(inputs, name)
        if value is not None:
            found[name.replace("_px", "").replace("_", " ")] = repr(value)
    return found


def _exchanged(recorded: InputsRecord, found: InputsRecord) -> bool:
    crossed = (found.left.sha256, found.right.sha256) == (recorded.right.sha256, recorded.left.sha256)
    return crossed and found.left.sha256 != found.right.sha256


def _compared(recorded: Mapping[str, str], found: Mapping[str, str]) -> Iterator[tuple[str, str | None]]:
    """Yield every name, and what differs about it."""
    for name in dict.fromkeys((*recorded, *found)):
        if name not in found:
            yield name, f"{name}: the record has one, now there is none"
        elif name not in recorded:
            yield name, f"{name}: the record has none"
        elif recorded[name] != found[name]:
            yield name, f"{name}: the record has {_short(recorded[name])}, now it is {_short(found[name])}"
        else:
            yield name, None


def _short(text: str) -> str:
    return text[:16] if len(text) == 64 and " " not in text else text


def _other_versions(recorded: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    return [
        f"{name} was {recorded[name]} and is {now[name]}"
        for name in now
        if name in recorded and recorded[name] != now[name]
    ]
