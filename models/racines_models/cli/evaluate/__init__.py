"""The commands `racines eval …`."""
