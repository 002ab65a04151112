from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal

import pytest
from pydantic import Field

from expert.facts import Vocabulary, vocabulary
from expert.rules.load import LoadedRules, load_rules
from modules.operator import Cost, Operator, OperatorParams
from modules.probe import FactModel, Probe, quantity


class Brightness(FactModel):
    """Brightness of the pair."""

    template: ClassVar[str] = "brightness"
    offset_dn: float = quantity("Difference", unit="dn", ge=-255, le=255, resolution=0.1, sigma="sigma_dn")
    sigma_dn: float = quantity("Its uncertainty", unit="dn", ge=0, le=255)
    clipped_fraction: float = quantity("Clipped share", ge=0, le=1)


class Side(FactModel):
    """One image of the pair."""

    template: ClassVar[str] = "side"
    keys: ClassVar[tuple[str, ...]] = ("side",)
    side: Literal["left", "right"] = quantity("Which")
    mean_dn: float = quantity("Mean", unit="dn", ge=0, le=255)


class MatchParams(OperatorParams):
    channels: Literal["gray", "each"] = Field("each", description="Maps")
    strength: float = Field(1.0, ge=0, le=1, description="Strength")
    radius_px: int = Field(3, ge=1, le=20, description="Radius in px")


class BlockParams(OperatorParams):
    window_px: int = Field(9, ge=3, le=51, description="Window in px")


def _same(state: Any, params: Any) -> Any:
    return state


def _nothing(subject: Any) -> Sequence[FactModel]:
    return ()


OPERATORS = {
    operator.name: operator
    for operator in (
        Operator("correction.match_histograms", "radiometry", MatchParams, _same, Cost(), "Match histograms."),
        Operator("correction.gain", "radiometry", MatchParams, _same, Cost(), "Apply a gain."),
        Operator("matching.block_match", "matcher", BlockParams, _same, Cost(), "Match blocks."),
    )
}
PROBES = {
    probe.name: probe
    for probe in (
        Probe("measurement.brightness", (Brightness,), _nothing, "cheap", "pair", "Measure brightness."),
        Probe("measurement.sides", (Side,), _nothing, "medium", "pair", "Measure sides."),
    )
}


@pytest.fixture(scope="session")
def words() -> Vocabulary:
    return vocabulary(PROBES.values())


@pytest.fixture(scope="session")
def operators() -> dict[str, Operator]:
    return OPERATORS


@pytest.fixture(scope="session")
def probes() -> dict[str, Probe]:
    return PROBES


@pytest.fixture
def load(words: Vocabulary, tmp_path: Path) -> Callable[..., LoadedRules]:
    def load_texts(*texts: str | bytes) -> LoadedRules:
        paths = []
        for number, text in enumerate(texts):
            path = tmp_path / "layers" / f"layer{number}.yaml"
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(text.encode() if isinstance(text, str) else text)
            paths.append(path)
        return load_rules(paths, words, OPERATORS, PROBES, shipped=False)

    return load_texts


@pytest.fixture(scope="session")
def good_text() -> str:
    return (Path(__file__).parent / "good.yaml").read_text()
