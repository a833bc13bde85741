"""Network blocks that generators share."""
