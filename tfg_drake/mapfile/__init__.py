"""Maps on disk: saved, loaded and continued, looked at, and in other formats."""
