"""The types of the arrays that the models, the search and the identification give to each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]
"""Mask: whether each sample belongs to something. Index: the numbers of samples, rows, columns or parts."""
