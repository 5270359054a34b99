"""Xi2023: the height follower's oscillator, calibration, filters and errors; its studies lie in five files.

They are named in the order of the paper, which is that of the page.
"""

import importlib

for _part in ("sensor", "filters", "table", "accuracy", "operator"):
    importlib.import_module(f"{__package__}.xi2023_{_part}")
