"""The leaderboard: submissions, records, boards, audits, the studio, and the `racines` command."""

from racines_data import renamed

renamed.install()
