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
    """Error variances on each of :data:`STAIRS`, µm², shape (stairs, 3): at the first horizon, the same as the drive
    leaves it, and at the last horizon.

    Args:
        random: of the sheet, µm².
        sight: of the machine.
        horizons: control periods from the newest reading to what is predicted, rising by 1.
        reach: µm by which 1, 2, … commands move the head.
    """
    first = int(horizons[0])
    told = Told(random, sight.noise, sight.finest, max(STAIRS[-1] - first + 1, 1))
    found = np.array([[told.variance(int(h), max(stair + 1 - int(h), 0)) for h in horizons] for stair in STAIRS])
    return np.column_stack([found[:, 0], held_back(found.T, reach), found[:, -1]])


def mean_square(random: Random, sight: Sight, horizons: np.ndarray, reach: np.ndarray, periods: int) -> float:
    """No controller's mean-square error over ``periods`` scored control periods is below this, µm².

    Any choice among the stairs makes a bound, with the limits of the drive or without; the highest is taken. Few stairs
    are coarse, of many a single reading matters to more, so that lowering the head is allowed to gain more.
    """
    found = stairs(random, sight, horizons, reach)
    most = [i for i, stair in enumerate(STAIRS) if stair < periods and not sight.pays(stair, found[i, 2])]
    choices = [most[:last:thin] for last in range(1, len(most) + 1) for thin in (1, 2, 4)]
    return max(
        _mean(found[some, error], found[some, moved], np.array(STAIRS)[some], sight, periods)
        for some in choices
        for error, moved in ((0, 0), (1, 2))
    )


def _mean(errors: np.ndarray, moved: np.ndarray, begins: np.ndarray, sight: Sight, periods: int) -> float:
    """Mean over all periods of ``errors`` on stairs that begin so, less what lowering gains.

    ``moved`` bounds how much a reading matters to the error on each stair: to that on its own and on those after it.
    """
    gain = sight.gain(np.cumsum(moved[::-1])[::-1])
    return float(max(np.diff(np.append(begins, periods)) @ (errors - gain), 0.0)) / periods
