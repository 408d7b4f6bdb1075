"""Short names for types of arrays; docstrings say their shapes."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.intp]
Record = NDArray[Any]
"""Of a structured type, as compiled code reads and changes it."""
