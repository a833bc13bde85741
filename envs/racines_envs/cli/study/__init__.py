"""The commands `racines study …`."""
