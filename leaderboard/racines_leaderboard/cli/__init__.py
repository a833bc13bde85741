"""The commands on the boards, and the `racines` command put together from all four packages."""
