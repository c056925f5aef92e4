"""Commands that calibrate a rig and exchange it with other programs."""
