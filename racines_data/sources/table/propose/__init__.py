"""A mapping proposed from what stands in a folder, and asked for, and written with comments.

`columns` tells what columns of a table are by their names and numbers, `pictures` which images go
with its rows; `guess` puts a mapping together; `ask` asks for what matters; `write` writes it.
"""
