"""Studies: what each part of the phantom brings, what a split leaks, what the truth scores."""
