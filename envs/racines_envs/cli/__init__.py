"""The commands on agents and environments: one module a command, one folder a group."""
