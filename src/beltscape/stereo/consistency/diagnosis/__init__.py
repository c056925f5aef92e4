"""Diagnosis of inconsistent cameras: moved, exchanged, mirrored, or too little to match."""
