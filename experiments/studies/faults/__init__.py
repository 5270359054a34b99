"""The fault campaign: ``python -m kerfgym.experiments.studies.faults``.

Every shipped follower gets faults of its command and of its sensor, one each run, at random moments of ordinary sheets.
Each run is repeated on the same seed without the fault, and with the fault but other parts taken out, so that a
collision has a cause (:mod:`faults.culprits`):

``inject``   puts the faults into the machines;
``draws``    which faults there are, and how they are drawn;
``trials``   runs them;
``verdict``  tells who is to blame;
``tables``   says it all.
"""
