"""The pipeline: joins the stages to whole commands (plan, simulate, calibrate, reconstruct, measure, run live)."""
