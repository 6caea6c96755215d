"""The commands of tfg-drake, a file each."""
