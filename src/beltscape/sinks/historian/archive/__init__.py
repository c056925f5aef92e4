"""Closed days as Parquet files, and retention."""
