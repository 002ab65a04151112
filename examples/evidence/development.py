"""The development pairs, as the scripts about matching take them from the command line."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

from modules.formats.datasets import DatasetPair, read_index


def development_pairs(description: str | None, every: int = 4) -> list[DatasetPair]:
    """Read `--data` and `--every` from the command line and return every N-th development pair.

    Parameters
    ----------
    description : str or None
        What `--help` says of the script.
    every : int
        N where the command line does not say.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--data", type=Path, default=os.environ.get("TERREX_DATA") or None, help="folder with an INDEX.json"
    )
    parser.add_argument("--every", type=int, default=every, help="take every N-th pair only")
    given = parser.parse_args()
    if given.data is None:
        parser.error("name the folder of the pairs with --data, or set TERREX_DATA")
    return list(read_index(given.data, "dev"))[:: given.every]


def of_another_scene(pairs: Sequence[DatasetPair], number: int) -> DatasetPair:
    """Return the next pair after that of this number, from the start again after the last, that shows another scene."""
    following = (*pairs[number + 1 :], *pairs[:number])
    found = next((pair for pair in following if pair.group != pairs[number].group), None)
    if found is None:
        raise SystemExit("all pairs show one scene; take more of them with a smaller --every")
    return found
