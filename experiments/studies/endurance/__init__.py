"""Endurance: do controllers get worse in minutes? ``python -m kerfgym.experiments.studies.endurance``.

Every follower is run for 300 s over ordinary and hard sheets, and whole along a drawing if one is given. The error is
kept in windows of 10 s only (:mod:`endurance.stream`), and judged by rules that are written down in
:mod:`endurance.worse`; :mod:`endurance.sheets` says over what, :mod:`endurance.windows` says it all.
"""
