"""Images drawn elsewhere, in a Parquet file: `file` serves them, `reader` checks every row."""
