"""Questions asked of agents and tasks: transfer, rewards, curves, where a step's time goes."""
