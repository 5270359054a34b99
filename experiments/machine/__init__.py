"""``kerfgym machine``: machines as files."""
