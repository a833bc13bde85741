"""Arms that hold the probe: what they are, where their joints stand, what they cannot do."""
