"""The bound of what is random for good and stationary: sheets of continuous spectrum, and bands of vibration.

Before the score begins all readings count as the finest that there are (:mod:`lowering`). What they told is forgotten
bit by bit, so the error rises from period to period (:class:`prediction.Told`). Here it rises in stairs: between two of
:data:`STAIRS` it is taken as it was at the lower one, which is the same as to be told the sheet anew in each period, as
it was that long ago. Then errors on a stair are all of one kind, as :mod:`lowering` needs it.
"""

import numpy as np

from .lowering import Sight
from .prediction import Told, held_back
from .spectrum import Random

STAIRS = (0, 2, 4, 6, 8, 10, 12, 16, 20, 24, 28, 32, 40, 48, 64, 80, 96, 128, 160, 192, 256, 320, 384)
"""Control periods after the score has begun."""


def stairs(random: Random, sight: Sight, horizons: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Error variances on each of :data:`STAIRS`, µm², shape (stairs, 2): as the drive leaves them, at the last horizon.

    Args:
        random: of the sheet, µm².
        sight: of the machine.
        horizons: control periods from the newest reading to what is predicted, rising by 1.
        reach: µm by which 1, 2, … commands move the head.
    """
    first = int(horizons[0])
    told = Told(random, sight.noise, sight.finest, max(STAIRS[-1] - first + 1, 1))
    found = np.array([
        [told.variance(int(h), max(stair + 1 - int(h), 0)) for h in horizons] for stair in STAIRS
    ])  # fmt: skip
    return np.column_stack([held_back(found.T, reach), found[:, -1]])


def mean_square(random: Random, sight: Sight, horizons: np.ndarray, reach: np.ndarray, periods: int) -> float:
    """No controller's mean-square error over ``periods`` scored control periods is below this, µm²."""
    found = stairs(random, sight, horizons, reach)
    many = [i for i, stair in enumerate(STAIRS) if stair < periods and not sight.pays(stair, found[i, 1])]
    found, ends = found[many], np.append(np.array(STAIRS)[many], periods)
    lengths = np.diff(ends)
    # A reading matters to the errors on its own stair and on those after it.
    sensitivity = np.cumsum(found[::-1, 1])[::-1]
    return float(max(lengths @ (found[:, 0] - sight.gain(sensitivity)), 0.0)) / periods
