"""The boards as one HTML page that needs no server and no other host."""
