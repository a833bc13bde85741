"""The commands `racines export …`."""
