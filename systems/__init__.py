"""LeafSystems, one component a file: thin shells round `tfg_drake`."""
