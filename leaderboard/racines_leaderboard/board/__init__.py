"""Boards: records collected, ranked, and written as tables, charts and pages."""
