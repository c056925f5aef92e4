"""The current values on which alarms are evaluated, and the periodic checks of lumps and edges."""
