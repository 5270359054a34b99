"""The machine written a second time, as something independent to compare the compiled one with."""
