"""Fronts of cutting: what time, dross, Rz and contour error cost each other, by tuned rules and by learned policies."""
