"""Agents: what chooses the next action. A new agent is one file and one entry point."""

from racines_envs.agents.protocol import Agent, agent_class, agent_names, learns, load_agent, sees

__all__ = ["Agent", "agent_class", "agent_names", "learns", "load_agent", "sees"]
