"""Files read and written, YAML with one line an error, the unit of stamps."""
