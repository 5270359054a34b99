"""``kerfgym export``: a controller leaves as C code, with what proves it."""
