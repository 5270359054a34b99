"""A folder of drawings and programmes, read and judged: ``python -m kerfgym.experiments.studies.corpus FOLDER``.

Anybody can point it at his own files. Each is read in a process of its own with a limit of time and memory
(:mod:`corpus.each`), compared with an independent reading where there is one (:mod:`corpus.programmes`,
:mod:`corpus.drawings`), and gets a verdict (:mod:`corpus.judged`); :mod:`corpus.accepted` says it all.
"""
