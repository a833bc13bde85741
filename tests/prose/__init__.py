"""Figures in prose: where they come from, and which have no origin (`make docs-numbers`)."""
