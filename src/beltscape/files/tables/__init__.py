"""Tables: CSV of encoders, densities and flow."""
