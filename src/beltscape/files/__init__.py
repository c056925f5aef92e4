"""Reading and writing of all file formats, one module per format.

The formats of other programs are in `exchange`. Beltscape's own documents: `rig_json` (with `rig_limits`),
`intrinsics_json`, `belt_json`; `json_text` and `toml_text` are their texts, `json_number` is a number of them
that may be null. A capture: `capture` with its `frame_names`, `images`, `camera_types`, `exposures_csv` and
`encoder_csv`; `reconstruction` is the folder that follows from it. Results: `flow_csv`, `fused_belt`, `tiff`,
`arrays`, `stl`, and `clouds` as `ply` or `las`. `csv_table` reads small tables, `density` those of bulk densities.

`paths` checks the files that people give, `atomic` writes files whole, `output_folder` owns a folder,
`sqlite_failures` names the causes of SQLite's errors.
"""
