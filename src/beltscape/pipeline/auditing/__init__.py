"""How a total came about: `total` names it, `explanation` reads records, runs and events, `alarms` pairs these."""
