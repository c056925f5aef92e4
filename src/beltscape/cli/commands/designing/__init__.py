"""Commands that design a rig: plan, printed and projected targets, simulated captures, the demo."""
