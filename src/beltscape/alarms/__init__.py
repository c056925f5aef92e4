"""What the operator must be told: limits with hysteresis, acknowledgement."""
