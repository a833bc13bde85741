"""The published weights for others: `card` describes a set, `push` sends it to the Hub."""
