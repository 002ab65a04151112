"""Print how many points agree, and what is matched, where two images show one scene and where they do not.

The evidence behind MEA008 and MAT041 to MAT043: the left image of every N-th development pair with its right image,
both exchanged, the right one under heavy noise, and that of another scene; points that agree with one row model, and
pixels that get a disparity, by profile.

    TERREX_DATA=FOLDER python examples/evidence/unrelated.py [--every 4]
"""

from __future__ import annotations

import numpy as np
from development import development_pairs, of_another_scene

from expert import ExpertSystem, StereoPair
from modules.formats.datasets import DatasetPair
from modules.simulation.distortions import distort_right
from modules.types import Image

PROFILES = ("fast", "balanced", "best")
NOISE_STRENGTH = 1.5


def cut(left: Image, right: Image) -> tuple[Image, Image] | None:
    """Cut two images to one size; None where one is gray and the other in colour."""
    if left.ndim != right.ndim:
        return None
    rows, columns = (min(a, b) for a, b in zip(left.shape[:2], right.shape[:2], strict=True))
    return np.ascontiguousarray(left[:rows, :columns]), np.ascontiguousarray(right[:rows, :columns])


def tell(name: str, images: tuple[Image, Image], pair: DatasetPair, systems: list[ExpertSystem]) -> None:
    """Print one line."""
    limit = min(pair.ndisp, images[0].shape[1] - 1)
    results = [system.reconstruct(StereoPair(*images, disparity_range_px=(0, limit))) for system in systems]
    facts = [fact for result in results for fact in result.decision.facts if fact.template == "row_alignment"]
    count = facts[0].fields["count"] if facts else "-"
    shares = "".join(f"{100 * np.isfinite(result.disparity_px).mean():10.1f}" for result in results)
    print(f"{pair.name[-24:]:24s} {name:12s} {count!s:>8s}{shares}")


def main() -> None:
    pairs = development_pairs(__doc__)
    systems = [ExpertSystem(profile=profile) for profile in PROFILES]
    print(f"{'pair':24s} {'right image':12s} {'agreeing':>8s}" + "".join(f"{profile:>10s}" for profile in PROFILES))
    for number, pair in enumerate(pairs):
        noisy = distort_right(pair.views, "noise", number, NOISE_STRENGTH).right
        other = cut(pair.views.left, of_another_scene(pairs, number).views.right)
        tell("its own", (pair.views.left, pair.views.right), pair, systems)
        tell("exchanged", (pair.views.right, pair.views.left), pair, systems)
        tell("noisy", (pair.views.left, noisy), pair, systems)
        if other is not None:
            tell("another", other, pair, systems)


if __name__ == "__main__":
    main()
