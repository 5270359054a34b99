"""Numbers in README and manual that a run made: recorded by studies, written into the pages by a script.

``python -m kerfgym.experiments.manual`` runs *studies* (:mod:`registry`). Each leaves one small file,
``docs/results/<name>.json`` (:mod:`recorded`): numbers, command, seeds, version, and a hash of what they depend on
(:mod:`stamp`). Tables (:mod:`tables`) and single numbers in a sentence (:mod:`marks`) are made from these files; nobody
types them.
"""
