"""The commands on datasets, and the options and settings that all commands share.

`racines_leaderboard.cli.command` puts the `racines` command together.
"""
