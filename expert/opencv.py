"""The expert system behind the interface of `cv2.StereoMatcher`, for programs that use `cv2.StereoSGBM`.

The methods have the names that OpenCV gives them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from expert.api import ExpertSystem, Profile
from expert.decision import Decision
from expert.pair import PairError, StereoPair
from expert.result import Result
from modules.types import Image

ChannelOrder = Literal["bgr", "rgb"]

STEPS = 16  # disparities are int16 in 1/16 px
LARGEST_PX = 2047  # an int16 of 1/16 px ends here


def _kept(name: str) -> tuple[Callable[[ExpertMatcher], int], Callable[[ExpertMatcher, int], None]]:
    """Return getter and setter of a value that is kept for the program and decides nothing."""

    def get(self: ExpertMatcher) -> int:
        return self._values[name]

    def put(self: ExpertMatcher, value: int) -> None:
        self._values[name] = int(value)

    get.__doc__ = f"Return `{name}` as it was set; the rules decide instead."
    put.__doc__ = f"Keep `{name}`; the rules decide instead."
    return get, put


class ExpertMatcher:
    """A drop-in for `cv2.StereoSGBM`: the same methods, but every pair is decided by the rules.

    `minDisparity` and `numDisparities` say which disparities are searched, as in OpenCV; with 0 disparities the system
    estimates the range of every pair. The other parameters (block size, penalties, checks) can be set and read, so that
    programs run unchanged, but decide nothing: the rules choose for each pair what a program chooses for all.

    One object keeps the result of its last call and is for one thread; make one per thread.

    Attributes
    ----------
    result : Result or None
        Everything the last call gave, with validity and uncertainty per pixel; None before the first call.
    """

    getBlockSize, setBlockSize = _kept("blockSize")
    getP1, setP1 = _kept("P1")
    getP2, setP2 = _kept("P2")
    getDisp12MaxDiff, setDisp12MaxDiff = _kept("disp12MaxDiff")
    getPreFilterCap, setPreFilterCap = _kept("preFilterCap")
    getUniquenessRatio, setUniquenessRatio = _kept("uniquenessRatio")
    getSpeckleWindowSize, setSpeckleWindowSize = _kept("speckleWindowSize")
    getSpeckleRange, setSpeckleRange = _kept("speckleRange")
    getMode, setMode = _kept("mode")

    def __init__(self, system: ExpertSystem, channel_order: ChannelOrder, values: dict[str, int]) -> None:
        self._system = system
        self._channel_order = channel_order
        self._values = values
        self._searched: tuple[int, int] | None = None  # by the last call, where the range was estimated
        self.result: Result | None = None

    @property
    def decision(self) -> Decision | None:
        """Why the last pair was matched as it was; None before the first call."""
        return None if self.result is None else self.result.decision

    def compute(
        self, left: NDArray[Any], right: NDArray[Any], disparity: NDArray[np.int16] | None = None
    ) -> NDArray[np.int16]:
        """Return the disparity of a rectified pair in the format of `cv2.StereoMatcher.compute`.

        Parameters
        ----------
        left, right : (H, W) or (H, W, 3), uint8 or uint16
            Colour in the channel order that the matcher was made for.
        disparity : int16 (H, W), optional
            Filled and returned, as OpenCV does.

        Returns
        -------
        int16 (H, W)
            Disparity in 1/16 px; `(minDisparity - 1) * 16` where there is none. Where the range was estimated,
            `getMinDisparity()` and `getNumDisparities()` tell it afterwards.

        Raises
        ------
        expert.pair.PairError
            The images do not fit together, the range does not fit them, or `disparity` has another shape or dtype.
        """
        pair = StereoPair(self._rgb(left), self._rgb(right), disparity_range_px=self._given_range())
        shape = pair.left.shape[:2]
        if disparity is not None and (disparity.shape != shape or disparity.dtype != np.int16):
            raise PairError(f"disparity is {disparity.shape} {disparity.dtype}; give an int16 array of shape {shape}")
        self.result = self._system.reconstruct(pair)
        self._searched = None if pair.disparity_range_px else _searched(self.result.decision)
        fixed = self._fixed_point(self.result.disparity_px)
        if disparity is None:
            return fixed
        disparity[:] = fixed
        return disparity

    def _fixed_point(self, found: NDArray[np.float32]) -> NDArray[np.int16]:
        low = self.getMinDisparity()
        with np.errstate(invalid="ignore"):
            valid = (found >= low - 0.5) & (found <= LARGEST_PX)
        steps = np.rint(np.where(valid, np.maximum(found, low), low - 1) * STEPS)
        return np.asarray(steps, np.int16)

    def _rgb(self, image: NDArray[Any]) -> Image:
        if self._channel_order == "bgr" and isinstance(image, np.ndarray) and image.ndim == 3 and image.shape[2] >= 3:
            return np.ascontiguousarray(image[..., 2::-1])
        return image

    def _given_range(self) -> tuple[int, int] | None:
        low, count = self._values["minDisparity"], self._values["numDisparities"]
        return (low, low + count) if count > 0 else None

    def getMinDisparity(self) -> int:
        """Return the smallest disparity searched, px."""
        return self._values["minDisparity"] if self._searched is None else self._searched[0]

    def setMinDisparity(self, value: int) -> None:
        """Set the smallest disparity searched, px; it counts where `numDisparities` is not 0."""
        self._values["minDisparity"] = int(value)
        self._searched = None

    def getNumDisparities(self) -> int:
        """Return the number of disparities searched; 0 before the first call where it will be estimated."""
        return self._values["numDisparities"] if self._searched is None else self._searched[1] - self._searched[0]

    def setNumDisparities(self, value: int) -> None:
        """Set the number of disparities searched, not negative; 0 estimates the range of every pair.

        Raises
        ------
        ValueError
            If it is negative.
        """
        self._values["numDisparities"] = _not_negative(value)
        self._searched = None


def _not_negative(count: int) -> int:
    if count < 0:
        raise ValueError(f"numDisparities {count} is negative; give the number to search, or 0 to estimate the range")
    return int(count)


def _searched(decision: Decision) -> tuple[int, int] | None:
    """Return the range that the plan searched, or None where the pair was refused before."""
    step = next((step for step in decision.steps() if step.operator == "matching.use_range"), None)
    return None if step is None else (int(step.parameters["min_px"]), int(step.parameters["max_px"]))


def create_matcher(
    minDisparity: int = 0,
    numDisparities: int = 0,
    blockSize: int = 5,
    P1: int = 0,
    P2: int = 0,
    disp12MaxDiff: int = 0,
    preFilterCap: int = 0,
    uniquenessRatio: int = 0,
    speckleWindowSize: int = 0,
    speckleRange: int = 0,
    mode: int = cv2.STEREO_SGBM_MODE_SGBM,
    *,
    channel_order: ChannelOrder = "bgr",
    profile: Profile = "balanced",
    rules: Sequence[str | Path] = (),
    time_budget_s: float | None = None,
    memory_budget_mb: float | None = None,
) -> ExpertMatcher:
    """Make a matcher that takes the place of `cv2.StereoSGBM.create`.

    Parameters
    ----------
    minDisparity, numDisparities : int
        Disparities to search, px; any number of them. With 0 disparities the range of every pair is estimated.
    blockSize, P1, P2, disp12MaxDiff, preFilterCap, uniquenessRatio, speckleWindowSize, speckleRange, mode : int
        Kept for `get...`; the rules decide instead.
    channel_order : {"bgr", "rgb"}
        Order of the channels of colour images; OpenCV reads BGR.
    profile, rules, time_budget_s, memory_budget_mb
        As for `ExpertSystem`.

    Raises
    ------
    ValueError
        `numDisparities` is negative or the channel order unknown.
    expert.rules.problem.RuleFileError
        A rule file is wrong.

    Examples
    --------
    >>> matcher = create_matcher(minDisparity=0, numDisparities=64, blockSize=5)
    >>> matcher.getNumDisparities(), matcher.getBlockSize(), matcher.decision
    (64, 5, None)
    """
    if channel_order not in ("bgr", "rgb"):
        raise ValueError(f"channel_order {channel_order!r} is unknown; use 'bgr' or 'rgb'")
    values = {
        "minDisparity": minDisparity,
        "numDisparities": _not_negative(numDisparities),
        "blockSize": blockSize,
        "P1": P1,
        "P2": P2,
        "disp12MaxDiff": disp12MaxDiff,
        "preFilterCap": preFilterCap,
        "uniquenessRatio": uniquenessRatio,
        "speckleWindowSize": speckleWindowSize,
        "speckleRange": speckleRange,
        "mode": mode,
    }
    system = ExpertSystem(rules, profile, time_budget_s=time_budget_s, memory_budget_mb=memory_budget_mb)
    return ExpertMatcher(system, channel_order, values)
