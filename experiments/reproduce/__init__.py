"""The five documents, reproduced: what each claims, beside what the simulation says, and whether that agrees.

``claims.py`` holds what a row, a figure and a study are; one file a document holds its studies; ``run.py`` runs them,
``page.py`` writes the page.
"""
