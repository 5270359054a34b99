"""CN102528288A: the digital height controller's measurement, commands and follow flow."""
