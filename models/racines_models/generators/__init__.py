"""One file a generator; `racines_models.registry` finds them by entry point."""
