"""The commands `racines train …`."""
