"""What is evaluated: terrex in a profile, with or without some rules, behind the same interface as a fixed pipeline."""

from __future__ import annotations

import hashlib
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal, Protocol

from expert.api import ExpertSystem, Profile
from expert.decision import Decision
from expert.pair import StereoPair
from expert.versions import versions
from modules.types import FloatImage, Matching, Views


@dataclass(frozen=True)
class Outcome:
    """What a system made of one pair.

    Attributes
    ----------
    matching : Matching or None
        None where it gave nothing.
    failure : str or None
    decision : Decision or None
        Of an expert system.
    cpu_s, peak_mb : float or None
        What it took in a process of its own; None where it worked in this one.
    """

    matching: Matching | None
    failure: str | None = None
    decision: Decision | None = None
    cpu_s: float | None = None
    peak_mb: float | None = None

    @property
    def disparity_px(self) -> FloatImage | None:
        """The disparity, float32 (H, W), NaN where invalid."""
        return (
            None if self.matching is None or self.matching.disparity is None else self.matching.disparity.disparity_px
        )


class System(Hashable, Protocol):
    """A way from a pair to a disparity."""

    @property
    def name(self) -> str:
        """Name in tables; unique within an evaluation."""

    @property
    def kind(self) -> str:
        """`terrex`, `fixed` or `peer`."""

    def digest(self) -> str:
        """Identify what would be run, so that a change is noticed."""

    def run(self, views: Views, ndisp: int) -> Outcome:
        """Process a pair with disparities from 0 to below `ndisp`."""


def digest_of(*parts: object) -> str:
    """Return a digest of what would be run, in these versions of terrex and of what its results depend on."""
    used = {name: version for name, version in versions().items() if name != "python"}
    return hashlib.sha256(repr((parts, used)).encode()).hexdigest()[:16]


@dataclass(frozen=True)
class ExpertConfiguration:
    """Terrex in one profile.

    Attributes
    ----------
    name : str
    profile : {"fast", "balanced", "best"}
    rules : tuple of str
        Files layered on the shipped rules.
    disabled : tuple of str
        Rules left out, for ablation.
    range : {"given", "estimated"}
        Whether the system is told the disparities to search or finds out by itself.
    """

    name: str
    profile: Profile = "balanced"
    rules: tuple[str, ...] = ()
    disabled: tuple[str, ...] = ()
    range: Literal["given", "estimated"] = "given"
    kind: str = "terrex"

    @cached_property
    def system(self) -> ExpertSystem:
        """The expert system, built at first use in each process."""
        with self._layers() as layers:
            return ExpertSystem(rules=layers, profile=self.profile)

    @contextmanager
    def _layers(self) -> Iterator[list[Path]]:
        files = [Path(name) for name in self.rules]
        if not self.disabled:
            yield files
            return
        with TemporaryDirectory() as folder:
            layer = Path(folder) / "left_out.yaml"
            layer.write_text(f"version: 1\ndisable: [{', '.join(self.disabled)}]\n", encoding="utf-8")
            yield [*files, layer]

    def digest(self) -> str:
        """Identify rules, profile and mode."""
        return digest_of(self.system.rules_digest, self.profile, self.range)

    def run(self, views: Views, ndisp: int) -> Outcome:
        """Reconstruct the pair; a pair that the system refuses leaves no disparity."""
        given = (0, min(ndisp, views.shape[1])) if self.range == "given" else None
        result = self.system.reconstruct(StereoPair(views.left, views.right, disparity_range_px=given))
        failure = None if result.reconstructed else "; ".join(item.sentence for item in result.decision.findings[:1])
        return Outcome(Matching(result.views, disparity=result.disparity), failure, result.decision)
