"""A folder of tiles of a map that does not fit in memory."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from modules.formats.errors import FormatError


class TileFolder:
    """Tiles by row and column, one NPZ each.

    Parameters
    ----------
    folder : Path
        Exists and is the caller's to remove.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def save(self, key: tuple[int, int], tile: dict[str, NDArray[np.float32]]) -> None:
        """Keep a tile.

        Raises
        ------
        FormatError
            It cannot be written.
        """
        path = self._path(key)
        try:
            with path.open("wb") as file:
                np.savez(file, **tile)  # type: ignore[arg-type]
        except OSError as error:
            raise FormatError(f"{path} cannot be written ({error.strerror}); is the disk full?") from error

    def load(self, key: tuple[int, int]) -> dict[str, NDArray[np.float32]] | None:
        """Return a tile that was kept, or None."""
        path = self._path(key)
        if not path.is_file():
            return None
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}

    def keys(self) -> list[tuple[int, int]]:
        """Return the keys of all tiles that were kept."""
        found = (re.fullmatch(r"tile_(-?\d+)_(-?\d+)\.npz", path.name) for path in self._folder.iterdir())
        return sorted((int(match[1]), int(match[2])) for match in found if match)

    def _path(self, key: tuple[int, int]) -> Path:
        return self._folder / f"tile_{key[0]}_{key[1]}.npz"
