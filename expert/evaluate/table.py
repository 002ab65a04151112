"""The results as one table, cases x systems, and what the algorithm-selection literature makes of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from expert.evaluate.store import Row

Floats = NDArray[np.float64]
BOOTSTRAP_ROUNDS = 2000
INTERVAL = (2.5, 97.5)  # percentiles


@dataclass(frozen=True)
class Gap:
    """How much of the distance between the single best and the virtual best configuration a system closes.

    Attributes
    ----------
    single_best : str
        The fixed configuration with the lowest mean loss.
    single_best_loss, virtual_best_loss, loss : float
        Means over the cases; the virtual best takes the best fixed configuration for every case.
    closed : float or None
        `(single best - loss) / (single best - virtual best)`: 1 is the oracle, 0 the best fixed pipeline; None where
        the two do not differ.
    interval : (float, float) or None
        95 % interval of `closed` by a bootstrap over scenes.
    """

    single_best: str
    single_best_loss: float
    virtual_best_loss: float
    loss: float
    closed: float | None
    interval: tuple[float, float] | None


@dataclass(frozen=True)
class Table:
    """Complete results: every system has a row for every case.

    Attributes
    ----------
    systems : tuple of str
    kinds : mapping from system to `terrex`, `fixed` or `peer`
    rows : tuple of tuples of Row
        By case, then by system in the order of `systems`.
    """

    systems: tuple[str, ...]
    kinds: Mapping[str, str]
    rows: tuple[tuple[Row, ...], ...]

    @classmethod
    def of(cls, rows: Sequence[Row], systems: Sequence[str]) -> Table:
        """Make a table of the cases that every one of the systems has been run on."""
        by_case: dict[str, dict[str, Row]] = {}
        for row in rows:
            by_case.setdefault(row.case, {})[row.system] = row
        complete = [found for _, found in sorted(by_case.items()) if all(name in found for name in systems)]
        kinds = {name: found[name].kind for found in complete[:1] for name in systems}
        return cls(tuple(systems), kinds, tuple(tuple(found[name] for name in systems) for found in complete))

    def __len__(self) -> int:
        """Return the number of cases."""
        return len(self.rows)

    def where(self, keep: Callable[[Row], bool]) -> Table:
        """Return the table of the cases whose rows satisfy `keep`; it should look at the case, not at the system."""
        return Table(self.systems, self.kinds, tuple(rows for rows in self.rows if keep(rows[0])))

    def values(self, name: str) -> Floats:
        """Return one column of the rows, float (cases, systems); NaN where there is none."""
        found = [[getattr(row, name) for row in rows] for rows in self.rows]
        return np.array(found, dtype=np.float64).reshape(len(self.rows), len(self.systems))

    def mean(self, name: str, system: str) -> float:
        """Return the mean of a column over the cases, those without a value left out."""
        column = self.values(name)[:, self.systems.index(system)]
        return float(np.nanmean(column)) if np.isfinite(column).any() else float("nan")

    @cached_property
    def variants(self) -> tuple[str, ...]:
        """The distortions, in the order in which they first occur by case."""
        return tuple(dict.fromkeys(rows[0].variant for rows in self.rows))

    @cached_property
    def scenes(self) -> NDArray[np.str_]:
        """The scene of every case."""
        return np.array([rows[0].scene for rows in self.rows])

    @cached_property
    def fixed(self) -> tuple[str, ...]:
        """The fixed configurations."""
        return tuple(name for name in self.systems if self.kinds[name] == "fixed")

    def losses(self, names: Sequence[str], loss: str = "bad_1") -> Floats:
        """Return the losses of some systems, float (cases, names)."""
        return self.values(loss)[:, [self.systems.index(name) for name in names]]

    def gap(self, system: str, loss: str = "bad_1", seed: int = 0) -> Gap:
        """Return how much of the gap a system closes, with an interval over scenes.

        Parameters
        ----------
        system : str
        loss : str
            Column to minimise.
        seed : int
            Of the bootstrap.

        Raises
        ------
        ValueError
            There are no cases or no fixed configurations.

        References
        ----------
        P. Kerschke, H. H. Hoos, F. Neumann and H. Trautmann, Automated algorithm selection: survey and perspectives,
        Evolutionary Computation 27(1), 2019.
        """
        if not self.rows or not self.fixed:
            raise ValueError("the gap needs cases and fixed configurations; run both")
        fixed, own = self.losses(self.fixed, loss), self.losses([system], loss)[:, 0]
        best = int(np.argmin(fixed.mean(axis=0)))
        draws = [closed_gap(fixed[index], own[index]) for index in resample(self.scenes, BOOTSTRAP_ROUNDS, seed)]
        known = [value for value in draws if value is not None]
        low, high = np.percentile(known, INTERVAL) if known else (0.0, 0.0)
        return Gap(
            self.fixed[best],
            float(fixed[:, best].mean()),
            float(fixed.min(axis=1).mean()),
            float(own.mean()),
            closed_gap(fixed, own),
            (float(low), float(high)) if known else None,
        )


def closed_gap(fixed: Floats, own: Floats) -> float | None:
    """Return the closed gap of losses (cases, configurations) and (cases,); None where there is no gap."""
    single, virtual = float(fixed.mean(axis=0).min()), float(fixed.min(axis=1).mean())
    return None if single - virtual < 1e-9 else (single - float(own.mean())) / (single - virtual)


def resample(scenes: NDArray[np.str_], rounds: int, seed: int) -> list[NDArray[np.int64]]:
    """Draw scenes with replacement and return the cases of each draw: cases of one scene are not independent."""
    names = np.unique(scenes)
    members = [np.flatnonzero(scenes == name) for name in names]
    draw = np.random.default_rng(seed)
    return [np.concatenate([members[i] for i in draw.integers(0, len(names), len(names))]) for _ in range(rounds)]


def cross_validated(losses: Floats, scenes: NDArray[np.str_]) -> float:
    """Return the mean loss when the choice among systems is made without the scene that it is applied to.

    Parameters
    ----------
    losses : float (cases, systems)
    scenes : str (cases,)
        For every scene the system with the best mean over all other scenes is taken.
    """
    found = np.empty(len(losses))
    for name in np.unique(scenes):
        out = scenes == name
        rest = losses[~out] if (~out).any() else losses
        found[out] = losses[out, int(np.argmin(rest.mean(axis=0)))]
    return float(found.mean())
