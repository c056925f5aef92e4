"""Alarms for the operator: limits with hysteresis and delays, latching, acknowledgement, suppression.

`readings` and `settings` enter `rules`, which give each alarm's condition; `board` keeps an `entry` for every
alarm, moved by its `state_machine`, and a `snapshot` of them over restarts. `core.alarm_catalogue` lists the
alarms, `texts` has their lines in English. `management` has priorities, first-out and suppression by
ANSI/ISA-18.2; `statistics` are the key figures of the alarm system.
"""
