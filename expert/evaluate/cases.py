"""What is evaluated on: pairs with truth, each under several distortions of the right image."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from modules.formats.datasets import DatasetPair
from modules.simulation.distortions import REFERENCE_DISTORTIONS, distort_right
from modules.simulation.terrain import TerrainParams, render_terrain
from modules.types import Views

ATTITUDE_LIMIT_DEG = 15.0  # rendered bodies stand within this of level
NDISP_RENDERED = 96


class Source(Protocol):
    """Where a pair comes from."""

    @property
    def name(self) -> str:
        """Name in tables."""

    @property
    def group(self) -> str:
        """Pairs of one scene have one group; no group is split."""

    @property
    def differs(self) -> bool:
        """Whether the pair differs radiometrically by itself."""

    def load(self) -> DatasetPair:
        """Read or render the pair."""


@dataclass(frozen=True)
class RenderedTerrain:
    """A rendered pair of the paper's rig; roll, pitch and terrain follow from the seed."""

    seed: int

    @property
    def name(self) -> str:
        """Name in tables."""
        return f"rendered/{self.seed}"

    @property
    def group(self) -> str:
        """Every rendered terrain is a scene of its own."""
        return self.name

    @property
    def differs(self) -> bool:
        """The two cameras are alike."""
        return False

    @cached_property
    def params(self) -> TerrainParams:
        """Parameters of the rendering."""
        draw = np.random.default_rng(self.seed)
        roll, pitch = (round(float(x), 1) for x in draw.uniform(-ATTITUDE_LIMIT_DEG, ATTITUDE_LIMIT_DEG, 2))
        return TerrainParams(seed=self.seed, roll_deg=roll, pitch_deg=pitch)

    def load(self) -> DatasetPair:
        """Render the pair."""
        made = render_terrain(self.params)
        views = Views(made.left, made.right)
        return DatasetPair(self.name, self.group, "", views, made.disparity_px, made.nonocc, NDISP_RENDERED, False)


@dataclass(frozen=True)
class Variant:
    """A reference distortion at a strength; 1 is the reference itself."""

    name: str
    strength: float = 1.0

    def __str__(self) -> str:
        """Write it as it is given on the command line."""
        return self.name if self.strength == 1.0 else f"{self.name}:{self.strength:g}"


@dataclass(frozen=True)
class Case:
    """One pair under one distortion."""

    source: Source
    variant: Variant
    seed: int = 0

    @property
    def key(self) -> str:
        """What identifies the case in a store."""
        return f"{self.source.name}|{self.variant}|{self.seed}"

    def distort(self, views: Views) -> Views:
        """Apply the distortion; the noise follows from the key, so that no two cases share it."""
        noise = zlib.crc32(self.key.encode())
        return distort_right(views, self.variant.name, noise, self.variant.strength)


def parse_variants(texts: Iterable[str]) -> tuple[Variant, ...]:
    """Read variants such as `noise` or `noise:0.5`; `reference` stands for all ten.

    Raises
    ------
    ValueError
        A name is unknown or a strength is no number from 0 to 4.
    """
    found: dict[Variant, None] = {}
    for text in texts:
        if text == "reference":
            found.update({Variant(name): None for name in REFERENCE_DISTORTIONS})
            continue
        name, _, strength = text.partition(":")
        if name not in REFERENCE_DISTORTIONS:
            known = ", ".join(REFERENCE_DISTORTIONS)
            raise ValueError(f"there is no distortion {name!r}; known: reference (all of them), {known}")
        try:
            value = float(strength or 1.0)
        except ValueError:
            value = np.nan
        if not 0.0 <= value <= 4.0:
            raise ValueError(f"variant {text!r}: the strength {strength!r} is no number from 0 to 4, e.g. {name}:0.5")
        found[Variant(name, value)] = None
    return tuple(found)


def expand(sources: Sequence[Source], variants: Sequence[Variant], seeds: Sequence[int] = (0,)) -> tuple[Case, ...]:
    """Return every source under every variant and seed; the cases of one source stay together."""
    return tuple(Case(source, variant, seed) for source in sources for variant in variants for seed in seeds)
