"""Whether lead-ins stay in the scrap: ``python -m kerfgym.experiments.studies.leads``.

Sheets are made at random, so that it is known what is part and what is scrap (:mod:`.random_parts`); drawings of real
parts come from folders. The planner makes routes through them, and :mod:`.trespass` looks at every lead-in with shapely
alone, without asking the planner's own check.
"""
