"""How far each stage repeats itself, measured here and now, at a small size."""
