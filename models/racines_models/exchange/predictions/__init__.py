"""Images drawn elsewhere, in a Parquet file: `file` checks every row and serves them."""
