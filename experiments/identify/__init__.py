"""From a machine's logs to a model of it."""
