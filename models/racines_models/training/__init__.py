"""Parts of the trainer: what it feeds, averages, writes down and can resume."""
