"""Types of the ray caster, as far as this project uses it; embreex itself has none."""
