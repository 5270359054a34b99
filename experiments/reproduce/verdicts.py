"""The verdicts on a claim, in words."""

REPRODUCED = "reproduced"
CALIBRATED = "calibrated"
TREND = "trend only"
INPUT = "input"
PRESENT = "present"
FAILS = "does not hold here"
NOT = "not reproducible as printed"
VERDICTS = {
    REPRODUCED: "a printed figure or claim, met by the document's own method within a stated tolerance that a trivial "
    "predictor misses; nothing was fitted to it",
    CALIBRATED: "free parameters were fitted to this very number, so that it agrees proves nothing",
    TREND: "direction or order agree; but no figure is printed, or it is missed, or a trivial predictor meets it too, "
    "or another method than the document's was run",
    INPUT: "printed, and here a setting or plain arithmetic on settings; the run shows that it is in force, no more",
    PRESENT: "only named in the document, or not mentioned there; it is built here and does what the row says",
    FAILS: "what is printed is clear and the run contradicts it, or what is named does not work here",
    NOT: "what is printed contradicts itself or is incomplete; the note says which",
}
"""The verdicts and what they mean."""

NAMED, SILENT = "named", "not mentioned"
"""How the column of the paper begins where a document has no figure and no claim to compare with."""
