"""The leaderboard: submissions, results, ranking, tables, and the `racines` command."""
