"""Xi2023: the height follower's oscillator, calibration, filters and errors."""
