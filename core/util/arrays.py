"""Array types for annotations."""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[Any]  # of any float type; numpy's own generic types confuse its operators' types
IntArray: TypeAlias = NDArray[Any]  # of any integer type
Float32: TypeAlias = NDArray[np.float32]
Float64: TypeAlias = NDArray[np.float64]
Int32: TypeAlias = NDArray[np.int32]
Int64: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]
