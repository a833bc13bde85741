"""The commands on generators and their judges: one module a command, one folder a group."""
