"""Two models: a term that can be added to any model, and a function that is a whole model."""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from ga.model.record import Parameter, Term

SEVENTH = Term(
    "seventh",
    "the example: a spring that stiffens with the seventh power",
    (Parameter("K7", "N*m/rad^7", "stiffness of the seventh power", presence=True),),
    columns=lambda r: (r.angle**7,),
    rates=lambda r, c: (7.0 * r.angle**6 * c.dtheta,),
    pushed=lambda r, genes, moved: 7.0 * genes[0] * r.angle**6 * moved,
)


def power(
    time: NDArray[np.float64],
    dtheta: NDArray[np.float64],
    dtheta_dot: NDArray[np.float64],
    *,
    Kc: Annotated[float, "N*m/rad", 0.0, 1.0],  # noqa: N803 - the names of the parameters
    Bc: Annotated[float, "N*m*s/rad", 0.0, 0.01],  # noqa: N803
    n: Annotated[float, "-", 0.5, 2.0],
) -> NDArray[np.float64]:
    """The example: a spring whose torque rises with a power of the deflection."""
    del time
    return np.asarray(Kc * np.sign(dtheta) * np.abs(dtheta) ** n + Bc * dtheta_dot)
