"""Reports and interfaces of a running system, below everything that runs.

`translatable_message`: a line of text that a page shows in its own language. `findings`: results of the checks of the
system by its own data. `alarms`: states, priorities and suppression. `events`: frames, cameras, maintenance and zero
as they change. `interfaces`: sources, sinks, controls and observers, which the packages above implement.
"""
