"""What agents that learn share: settings, the run's folder, checkpoints, curves."""
