"""No sheet below: where the head stays once a supervisor's hold is over and the sheet is not back.

Over a slot the reading rises, and the supervisor holds the head. When its time is up it lets the law approach anew. But
a reading beyond the table is nothing to approach, and at an edge the reading comes down over a way of up to twice
``sensor.WIDEST`` while the sheet is where it was: who follows it there dives below the sheet, and meets the far edge.

So what was last known of the sheet counts: the head stood at the set height above it. It counts until the supervisor
takes the reading for the sheet, or until readings have been within the table for a way longer than an edge: then the
sheet lies deeper there, and is approached. It counts by way, not by time, so a slot may last as long as it likes, at
any feed. What it takes for the sheet is level: over a slot in a sloping sheet the head does not rise with it.
"""

from kerfgym.envs.engine.lanes import part
from kerfgym.envs.plant.calibration import SPAN
from kerfgym.envs.plant.controller import PERIOD
from kerfgym.envs.plant.sensor import WIDEST
from kerfgym.envs.plant.supervisor import FOLLOW, HOLD

WITHIN = 0.9 * SPAN
"""mm; what is read higher is no reading of a sheet."""

LONGER = 2.0 * WIDEST + 6.0
"""mm of readings within the table that no edge explains."""

# Places in the memory.
PLANE = 0  # mm, the sheet that was last known
HELD = 1  # whether the supervisor held the head in the period before
AWAY = 2  # whether there is no sheet below
READ = 3  # mm travelled with readings within the table
MEMORY = READ + 1


@part
def update(m, x):
    """Takes in a period's signals ``x``; ``m`` is this module's memory."""
    if x.fresh:
        for k in range(MEMORY):
            m[k] = 0.0
    if x.mode == HOLD:
        m[PLANE], m[HELD], m[AWAY] = x.head_position - x.set_height, 1.0, 0.0
        return
    if m[HELD] > 0.5:
        m[AWAY], m[READ] = 1.0, 0.0
    m[HELD] = 0.0
    m[READ] = m[READ] + x.feed * PERIOD if x.raw_height < WITHIN else 0.0
    if x.captured or x.mode != FOLLOW or m[READ] > LONGER:
        m[AWAY] = 0.0


@part
def is_away(m):
    """Whether there is no sheet below."""
    return m[AWAY] > 0.5
