"""Changes of a running plant without a stop: settings, rig, empty belt and certificates, read again as a whole."""
