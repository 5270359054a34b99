"""Writes ``figures.csv`` anew: ``python -m kerfgym.tests.recorded``.

After a change that is meant to change the machine or a law. The commit shows which figures moved and by how much, and
says why.
"""

from kerfgym.experiments.store import runs
from kerfgym.tests.recorded import figures

if __name__ == "__main__":
    runs.write_text(figures.FILE, figures.every().to_csv(index=False, float_format="%.9g"))
