"""Array types used in signatures, whose shapes stand in the docstrings; and how long arrays are taken apart."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]
ComplexArray: TypeAlias = NDArray[np.complex128]


def chunks(count: int, size: int = 1024) -> list[slice]:
    """Stretches of an array's first axis, one after the other, to bound the memory of what is done to each.

    At least one, so that nothing at all has results of the right shape too.
    """
    return [slice(start, min(start + size, count)) for start in range(0, max(count, 1), size)]
