"""Fit the tables that turn evidence into confidence and uncertainty, and show that they hold for scenes left out.

    python -m benchmarks.calibrate_confidence [--cache build/quality] [--folds 5] [--write]

Reads the runs that `python -m benchmarks.quality_runs` has made. Confidence is a sum of log odds, one monotone table
per kind of evidence at the pixel and one per kind over the map, fitted by logistic regression; the uncertainty is a sum
of log2 px, fitted to the median of the absolute error. Prints how well predicted and true frequencies agree, every
group of scenes predicted by tables fitted to others; `--write` writes `modules/primitives/confidence_tables.py`.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from benchmarks.quality_runs import BAD_PX, PATCH, SHIFTED
from modules.primitives.agreement import SCALES, UNKNOWN
from modules.primitives.confidence import chance_factor

Floats = NDArray[np.float64]
Loss = Callable[[Floats, Floats], tuple[Floats, Floats]]

KINDS = tuple(SCALES)
RISING = {  # whether more of it speaks for the disparity
    "correlation": 1, "misfit": -1, "surprise": -1, "localisation": -1,
    "left_right": -1, "excess": 1, "roughness": -1, "breaks": -1, "support": 1,
    "agreement": 1,
}  # fmt: skip
NODES = {
    "correlation": (0, 60, 100, 140, 170, 200, 220, 235, 245, 254),
    "misfit": (0, 40, 70, 95, 115, 135, 155, 180, 254),
    "surprise": (0, 40, 70, 100, 130, 160, 200, 254),
    "localisation": (0, 40, 70, 95, 120, 145, 170, 200, 254),
    "left_right": (0, 10, 25, 50, 75, 100, 150, 254),
    "excess": (0, 10, 25, 50, 80, 120, 180, 254),
    "roughness": (0, 5, 12, 25, 50, 90, 150, 254),
    "breaks": (0, 10, 31, 62, 110, 160, 210, 254),
    "support": (0, 60, 100, 140, 180, 210, 235, 254),
}
MAP_NODES = {
    "agreement": (0.1, 0.25, 0.4, 0.55, 0.7, 0.8, 0.9, 0.97),
    "left_right": (0, 8, 16, 24, 32, 45),
    "roughness": (0, 3, 8, 15, 25, 40),
    "breaks": (0, 5, 15, 30, 60, 120),
}
NUMBERS = ("edges", "agreement", "over_chance", "density", "bad_percent", "wrong_percent")  # of a run, as they are kept
TABLES = Path("modules/primitives/confidence_tables.py")
MEDIAN_OF_NORMAL = 0.6745  # median of the absolute value of a standard normal variable
RIDGE = 1e-5  # keeps tables finite where no pixel decides
NOT_PAIRS = ("unrelated", "periodic", "constant")  # kinds of runs whose images cannot match
EXACT_WEIGHT = 0.25  # of a run of these pairs in the fit of the uncertainty, beside one of rendered terrain
PER_RUN = 100  # pixels of each run that the fit sees
SIGMA_LIMIT_PX = 1.0  # larger errors are mismatches, of which the confidence speaks
PATCHED_WEIGHT, SHIFTED_WEIGHT = 8.0, 1.0  # of a run with wrong patches, all wrong, beside one of a development pair
TERRAIN_WEIGHT = 0.5
EXACT = ("terrain", "motorcycle", "pipes", "playtable", "recycle")  # groups whose truth is finer than 0.1 px


@dataclass(frozen=True)
class Runs:
    """Pixels with a disparity of many runs, and facts of each run.

    Attributes
    ----------
    codes : uint8 (K, N)
    error_px : float32 (N,)
        NaN where there is no truth.
    run : int32 (N,)
        The run that each pixel is of, rising.
    whole : float64 (R, kinds of MAP_NODES)
        Mean code over the run's map, NaN where unknown.
    edges : float64 (R,)
        Gradient of the image at steps of the disparity.
    factor : float64 (R,)
        What the agreement over chance leaves of the confidence.
    density, bad, wrong : float64 (R,)
        Share of pixels with a disparity, 0-1; of scored pixels missing or wrong, of valid ones wrong, %.
    names : list of (case, kind, group, configuration)
    """

    codes: NDArray[np.uint8]
    error_px: NDArray[np.float32]
    run: NDArray[np.int32]
    whole: Floats
    edges: Floats
    factor: Floats
    density: Floats
    bad: Floats
    wrong: Floats
    names: list[tuple[str, str, str, str]]

    def column(self, index: int) -> NDArray[np.str_]:
        """Return one part of the names."""
        return np.array([name[index] for name in self.names])

    @property
    def patched(self) -> NDArray[np.bool_]:
        """Which runs have wrong patches."""
        return np.char.startswith(self.column(3), PATCH)

    @property
    def hopeless(self) -> NDArray[np.bool_]:
        """Which runs are of images that cannot match."""
        return np.isin(self.column(1), NOT_PAIRS)

    @property
    def terrain(self) -> NDArray[np.bool_]:
        """Which runs are of rendered terrain."""
        return np.char.startswith(self.column(2), "terrain")

    def weights(self) -> Floats:
        """Return the weight of each run in the fit; images that cannot match are no part of it."""
        found = np.where(self.patched, PATCHED_WEIGHT, 1.0)
        found[np.char.endswith(self.column(3), SHIFTED)] = SHIFTED_WEIGHT
        found[self.terrain] *= TERRAIN_WEIGHT
        found[self.hopeless] = 0.0
        return found


def read_runs(cache: Path) -> Runs:
    """Read all runs of a cache."""
    codes, errors, runs, facts, names = [], [], [], [], []
    files = sorted(file for file in cache.glob("*.npz") if not file.name.endswith(".tmp.npz"))
    if not files:
        raise SystemExit(f"{cache} holds no runs; make them with python -m benchmarks.quality_runs")
    for file in files:
        with np.load(file) as kept:
            for configuration in [key.removesuffix("/codes") for key in kept.files if key.endswith("/codes")]:
                valid = kept[f"{configuration}/valid"]
                found = kept[f"{configuration}/codes"][:, valid]
                codes.append(found)
                errors.append(kept[f"{configuration}/error_px"][valid])
                runs.append(np.full(found.shape[1], len(names), np.int32))
                numbers = [float(kept[f"{configuration}/{key}"]) for key in NUMBERS]
                facts.append((*mean_codes(found), *numbers))
                names.append((file.stem.split("-")[0], str(kept["kind"]), str(kept["group"]), configuration))
    table = np.array(facts)
    edges, agreement, over_chance, density, bad, wrong = table[:, len(KINDS) :].T
    factor = np.array([chance_factor(None if np.isnan(value) else value) for value in over_chance])
    whole = np.column_stack([agreement if kind == "agreement" else table[:, KINDS.index(kind)] for kind in MAP_NODES])
    return Runs(
        np.hstack(codes), np.concatenate(errors), np.concatenate(runs), whole, edges, factor, density, bad, wrong, names
    )


def mean_codes(codes: NDArray[np.uint8]) -> list[float]:
    """Return the mean known code of every kind, NaN where none is known."""
    known = codes != UNKNOWN
    return [float(c[k].mean()) if k.any() else float("nan") for c, k in zip(codes, known, strict=True)]


def ramps(values: NDArray[Any], nodes: Sequence[float]) -> NDArray[np.float32]:
    """Return (N, len(nodes) - 1): how far each value has come between neighbouring nodes, 0 to 1."""
    steps = [(values - low) / np.float32(high - low) for low, high in pairwise(np.float32(nodes))]
    return np.clip(np.stack(steps, axis=1), 0, 1).astype(np.float32)


def block(values: NDArray[Any], unknown: NDArray[np.bool_], kind: str, nodes: Sequence[float]) -> NDArray[np.float32]:
    """Return the columns of one table: its ramps, signed so that weights are positive, and whether it is unknown."""
    known = ramps(np.where(unknown, nodes[0], values), nodes) * np.float32(RISING[kind])
    return np.hstack([known * ~unknown[:, None], unknown[:, None].astype(np.float32)])


def pixel_design(codes: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the columns of the pixel's evidence, after a constant."""
    blocks = [block(c, c == UNKNOWN, kind, NODES[kind]) for kind, c in zip(KINDS, codes, strict=True)]
    return np.hstack([np.ones((codes.shape[1], 1), np.float32), *blocks])


def map_design(whole: Floats) -> NDArray[np.float32]:
    """Return the columns of the map's evidence."""
    return np.hstack([block(v, np.isnan(v), k, MAP_NODES[k]) for v, k in zip(whole.T, MAP_NODES, strict=True)])


def limits(nodes: dict[str, tuple[float, ...]]) -> list[tuple[float | None, float | None]]:
    """Return the bounds of the weights of tables: steps are positive, the value where unknown is free."""
    return [limit for table in nodes.values() for limit in [(0.0, None)] * (len(table) - 1) + [(None, None)]]


def fit(x: NDArray[np.float32], target: Floats, weight: Floats, bounds: list, loss: Loss) -> Floats:
    """Return the weights of least loss within their bounds."""
    weight = weight / weight.sum()

    def total(w: Floats) -> tuple[float, Floats]:
        value, slope = loss((x @ w.astype(np.float32)).astype(np.float64), target)
        gradient = (weight * slope).astype(np.float32) @ x
        return float(weight @ value) + RIDGE * float(w @ w), gradient.astype(np.float64) + 2 * RIDGE * w

    start = np.zeros(x.shape[1])
    return minimize(total, start, jac=True, bounds=bounds, method="L-BFGS-B", options={"maxiter": 150}).x


def cross_entropy(z: Floats, target: Floats) -> tuple[Floats, Floats]:
    """Return the loss of log odds and its derivative."""
    return np.logaddexp(0, z) - target * z, 1 / (1 + np.exp(-z)) - target


def absolute(z: Floats, target: Floats) -> tuple[Floats, Floats]:
    """Return the absolute error, smoothed at zero, and its derivative; the least sum is at the median."""
    rest = z - target
    root = np.sqrt(rest * rest + 0.01)
    return root, rest / root


def sample(runs: Runs, wanted: NDArray[np.bool_], seed: int = 0) -> NDArray[np.int64]:
    """Return the indices of at most `PER_RUN` wanted pixels of every run."""
    source = np.random.default_rng(seed)
    index = np.flatnonzero(wanted)
    parts = np.split(index, np.searchsorted(runs.run[index], np.arange(1, len(runs.names))))
    return np.concatenate([p if len(p) <= PER_RUN else np.sort(source.choice(p, PER_RUN, False)) for p in parts])


def fit_confidence(runs: Runs, pixels: NDArray[np.int64]) -> Floats:
    """Return the weights of the tables of confidence."""
    run = runs.run[pixels]
    x = np.hstack([pixel_design(runs.codes[:, pixels]), map_design(runs.whole)[run]])
    good = (np.abs(runs.error_px[pixels]) <= BAD_PX).astype(np.float64)
    weight = (runs.weights() / np.maximum(np.bincount(run, minlength=len(runs.names)), 1))[run]
    return fit(x, good, weight, [(None, None), *limits(NODES), *limits(MAP_NODES)], cross_entropy)


def predict(runs: Runs, pixels: NDArray[np.int64], w: Floats) -> Floats:
    """Return the confidence of pixels."""
    split = 1 + len(limits(NODES))
    odds = pixel_design(runs.codes[:, pixels]) @ w[:split] + (map_design(runs.whole) @ w[split:])[runs.run[pixels]]
    return runs.factor[runs.run[pixels]] / (1 + np.exp(-odds.astype(np.float64)))


def fit_sigma(runs: Runs, pixels: NDArray[np.int64]) -> Floats:
    """Return the weights of the tables of uncertainty: those of maps with known excess, then those without."""
    codes, run = runs.codes[:, pixels], runs.run[pixels]
    error = np.log2(np.maximum(np.abs(runs.error_px[pixels]), 1e-3) / MEDIAN_OF_NORMAL)
    share = np.where(runs.terrain, 1.0, EXACT_WEIGHT)
    weight = (share / np.maximum(np.bincount(run, minlength=len(runs.names)), 1))[run]
    bounds = [(None, None), *limits(NODES)]
    known = codes[KINDS.index("excess")] != UNKNOWN
    return -np.concatenate(
        [fit(pixel_design(codes[:, part]), -error[part], weight[part], bounds, absolute) for part in (known, ~known)]
    )


def exact(runs: Runs) -> NDArray[np.bool_]:
    """Return which pixels have a right match and a truth that is fine enough to tell its error."""
    fine = np.isin(runs.column(2), EXACT) | runs.terrain
    return (fine & ~runs.hopeless & ~runs.patched)[runs.run] & (np.abs(runs.error_px) < SIGMA_LIMIT_PX)


def left_out(runs: Runs, wanted: NDArray[np.bool_], folds: int, train: Callable, use: Callable) -> Floats:
    """Return predictions for all pixels, each by weights fitted to the wanted pixels of other groups."""
    groups = sorted(set(runs.column(2)))
    fold = np.array([groups.index(group) % folds for group in runs.column(2)])[runs.run]
    found = np.full(len(runs.run), np.nan)
    for number in range(folds):
        w = train(runs, sample(runs, wanted & (fold != number)))
        pixels = np.flatnonzero(fold == number)
        for part in np.array_split(pixels, max(1, len(pixels) // 200_000)):
            found[part] = use(runs, part, w)
    return found


def use_sigma(runs: Runs, pixels: NDArray[np.int64], w: Floats) -> Floats:
    """Return the standard deviation of pixels, px."""
    codes = runs.codes[:, pixels]
    known = codes[KINDS.index("excess")] != UNKNOWN
    both = pixel_design(codes) @ np.stack(np.split(w, 2), axis=1)
    return np.exp2(np.where(known, both[:, 0], both[:, 1]).astype(np.float64))


def show_reliability(name: str, confidence: Floats, good: NDArray[np.bool_]) -> None:
    """Print predicted and true frequency by bins, and the mean difference."""
    edges = (0, 0.1, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 1.01)
    bins = np.digitize(confidence, edges) - 1
    parts, off = [], 0.0
    for number in sorted(set(bins)):
        inside = bins == number
        said, true = confidence[inside].mean(), good[inside].mean()
        off += abs(said - true) * inside.mean()
        parts.append(f"{said:.2f}/{true:.2f} ({100 * inside.mean():.0f} %)")
    print(f"  {name:12s} mean difference {off:.3f}; said/true: " + "  ".join(parts))


def show_sigma(name: str, relative: Floats) -> None:
    """Print the spread of errors over their predicted standard deviation."""
    spread = np.median(np.abs(relative)) / MEDIAN_OF_NORMAL
    print(f"  {name:12s} robust spread {spread:.2f}, within 2 sigma {100 * np.mean(np.abs(relative) <= 2):.1f} %")


def report(runs: Runs, confidence: Floats, sigma: Floats) -> None:
    """Print how predictions for scenes left out agree with their errors."""
    kind = runs.column(1)
    known, good = ~np.isnan(runs.error_px), np.abs(runs.error_px) <= BAD_PX
    pairs = ~runs.hopeless & ~runs.patched & ~runs.terrain
    own = np.char.find(runs.column(3), "robust") >= 0
    print("confidence, scenes left out")
    chosen = {"pairs": pairs, "pairs, robust": pairs & own, "terrain": runs.terrain & ~runs.patched}
    chosen |= {name: pairs & (kind == name) for name in sorted(set(kind[pairs]))}
    chosen["wrong patches"] = runs.patched & ~runs.terrain
    for name, which in chosen.items():
        use = known & which[runs.run]
        show_reliability(name, confidence[use], good[use])
    print("by the limit of the confidence: of the pairs, of the wrong patches, of images that cannot match")
    for limit in (0.0, 0.15, 0.25, 0.35, 0.5, 0.7):
        show_limit(runs, confidence >= limit, pairs & own, limit)
    print("uncertainty, scenes left out")
    with np.errstate(invalid="ignore"):
        right = exact(runs)
        relative = runs.error_px / sigma
    terrain, own = runs.terrain[runs.run], own[runs.run]
    for name, which in (
        ("terrain, robust", terrain & own),
        ("terrain, other", terrain & ~own),
        ("pairs, robust", ~terrain & own),
    ):
        show_sigma(name, relative[right & which])
    for name in sorted(set(kind[runs.terrain])):
        show_sigma(name, relative[right & terrain & own & (kind == name)[runs.run]])


def show_limit(runs: Runs, kept: NDArray[np.bool_], pairs: NDArray[np.bool_], limit: float) -> None:
    """Print what a limit keeps of right and wrong pixels."""
    known, good = ~np.isnan(runs.error_px), np.abs(runs.error_px) <= BAD_PX
    of_pairs, of_patched = known & pairs[runs.run], known & runs.patched[runs.run]
    count = len(runs.names)
    share = np.bincount(runs.run, kept, minlength=count) / np.maximum(np.bincount(runs.run, minlength=count), 1)
    hopeless = (100 * share * runs.density)[runs.hopeless]
    print(
        f"  {limit:.2f}: pairs, robust: wrong {100 * np.mean(~good[of_pairs & kept]):.2f} % of valid, "
        f"kept {100 * np.mean(kept[of_pairs]):.1f} %; "
        f"patches: {100 * np.mean(~kept[of_patched & ~good]):.1f} % of wrong and "
        f"{100 * np.mean(~kept[of_patched & good]):.1f} % of right rejected; "
        f"hopeless: at most {hopeless.max():.1f} % kept, mean {hopeless.mean():.2f} %"
    )


def tables_of(w: Floats, nodes: dict[str, tuple[float, ...]]) -> dict[str, tuple[tuple, tuple, float]]:
    """Return the weights as tables: nodes, values there, value where unknown."""
    found, at = {}, 0
    for kind, table in nodes.items():
        steps = w[at : at + len(table) - 1] * RISING[kind]
        values = tuple(round(float(v), 3) for v in np.concatenate([[0.0], np.cumsum(steps)]))
        found[kind] = (table, values, round(float(w[at + len(table) - 1]), 3))
        at += len(table)
    return found


def write_tables(runs: Runs, confidence: Floats, sigma: Floats) -> None:
    """Write the tables as a module."""
    split = 1 + len(limits(NODES))
    own, other = np.split(sigma, 2)
    parts = {
        "PIXEL": tables_of(confidence[1:split], NODES),
        "MAP": tables_of(confidence[split:], MAP_NODES),
        "SIGMA": tables_of(own[1:], NODES),
        "SIGMA_WITHOUT_EXCESS": tables_of(other[1:], NODES),
    }
    lines = [
        '"""Tables of confidence and uncertainty; written by `python -m benchmarks.calibrate_confidence --write`.',
        "",
        "Per kind of evidence: codes, what they contribute, and what missing evidence contributes. `PIXEL` and `MAP`",
        "are in log odds, `SIGMA` in log2 px, for maps whose matcher knows the excess or not.",
        f"Fitted to {len(runs.names)} runs of {len(set(runs.column(2)))} groups of scenes.",
        '"""',
        "",
        "from __future__ import annotations",
        "",
        "Tables = dict[str, tuple[tuple[float, ...], tuple[float, ...], float]]",
        "",
        f"CONSTANT = {confidence[0]:.3f}",
        f"SIGMA_CONSTANT = {own[0]:.3f}",
        f"SIGMA_CONSTANT_WITHOUT_EXCESS = {other[0]:.3f}",
    ]
    for name, table in parts.items():
        lines.append(f"{name}: Tables = {{")
        for kind, value in table.items():
            lines += [f'    "{kind}": (', *(f"        {part}," for part in value), "    ),"]
        lines.append("}")
    TABLES.write_text("\n".join(lines) + "\n", encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, default=Path("build/quality"))
    parser.add_argument("--folds", type=int, default=5, help="0 skips the evidence on scenes left out")
    parser.add_argument("--write", action="store_true", help=f"write {TABLES}")
    args = parser.parse_args()
    runs = read_runs(args.cache)
    known = ~np.isnan(runs.error_px)
    print(f"{len(runs.names)} runs of {len(set(runs.column(2)))} groups of scenes")
    if args.folds:
        confidence = left_out(runs, known, args.folds, fit_confidence, predict)
        report(runs, confidence, left_out(runs, exact(runs), args.folds, fit_sigma, use_sigma))
    if args.write:
        write_tables(runs, fit_confidence(runs, sample(runs, known)), fit_sigma(runs, sample(runs, exact(runs))))
        print(f"wrote {TABLES}")


if __name__ == "__main__":
    main()
