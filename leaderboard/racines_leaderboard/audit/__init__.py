"""The audit: whether what a record says holds, number by number."""
