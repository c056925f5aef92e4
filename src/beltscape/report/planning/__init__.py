"""The report page of a plan: feasibility, drawings of the rig, tables."""
