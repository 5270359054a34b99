"""Fuzzing: files of every kind that kerfgym reads, changed at random, must give a result or a clear error."""
