"""Files: written atomically, recordings of ports, trajectories, YAML with one line an error."""
