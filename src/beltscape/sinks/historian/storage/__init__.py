"""Tables, files and connections: the storage of records on disk.

The database: `schema` opens it and runs `migrations`, `connections` pools its readers, `rows`, `finding_rows` and
`sections` convert values, `failures` and `file_watch` detect damage. The days: `day_files` of the `day_table`, and
`finding_files`, in Parquet.
"""
